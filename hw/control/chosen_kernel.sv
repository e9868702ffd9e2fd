// Made by hw/registers.py from vsense_ros/accelerator/registers.py.
// The kernel of a number, with the parameters that it is built with.
module chosen_kernel #(parameter int NUMBER = 1) (
    input logic clk, rst_n, s_tvalid, s_tuser, m_tready, input logic [31:0] s_tdata,
    output logic s_tready, s_ends, m_tvalid, m_tlast, err, output logic [31:0] m_tdata, cycles
);
  generate if ((NUMBER != 5)) assign s_ends = 1'b0; endgenerate
  generate
    if (NUMBER == 1) begin : solve14
      gj_solver #(.N(14), .P(8), .DEEP(1)) kernel (.clk, .rst_n, .s_tvalid, .s_tready, .s_tdata, .m_tvalid, .m_tready, .m_tdata, .m_tlast, .err, .cycles);
    end else if (NUMBER == 2) begin : solve42
      gj_solver #(.N(42), .P(22), .DEEP(1)) kernel (.clk, .rst_n, .s_tvalid, .s_tready, .s_tdata, .m_tvalid, .m_tready, .m_tdata, .m_tlast, .err, .cycles);
    end else if (NUMBER == 3) begin : body_mass
      body_mass #(.ROWS(1), .DEEP(0)) kernel (.clk, .rst_n, .s_tvalid, .s_tready, .s_tdata, .m_tvalid, .m_tready, .m_tdata, .m_tlast, .err, .cycles);
    end else if (NUMBER == 4) begin : suspension_motion
      suspension_motion #(.U(12), .DEEP(1)) kernel (.s_tuser, .clk, .rst_n, .s_tvalid, .s_tready, .s_tdata, .m_tvalid, .m_tready, .m_tdata, .m_tlast, .err, .cycles);
    end else if (NUMBER == 5) begin : row_combiner
      row_combiner #(.L(16)) kernel (.s_ends, .clk, .rst_n, .s_tvalid, .s_tready, .s_tdata, .m_tvalid, .m_tready, .m_tdata, .m_tlast, .err, .cycles);
    end else if (NUMBER == 6) begin : solve56
      gj_solver #(.N(56), .P(19), .DEEP(1)) kernel (.clk, .rst_n, .s_tvalid, .s_tready, .s_tdata, .m_tvalid, .m_tready, .m_tdata, .m_tlast, .err, .cycles);
    end
  endgenerate
endmodule
