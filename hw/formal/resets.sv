// A reset of one clock is as good as any: two kernels that begin in whatever states, reached or not, and have one clock
// of reset take and give words at the same clocks from then on, whatever comes and whenever, and count the same. What
// they compute is compared by simulation (test_registers.py); the solver has two rows here, which change nothing of how
// its slots are followed by valid bits.
module formal_reset_solver (input logic clk, s_tvalid, m_tready, input logic [3:0] word, input logic sign);
  logic [1:0]  ready, valid, last, err;
  logic [31:0] data [0:1];
  logic [31:0] cycles [0:1];
  logic        rst_n = 1'b0;
  always_ff @(posedge clk) rst_n <= 1'b1;
  genvar i;
  generate
    for (i = 0; i < 2; i = i + 1) begin : one
      gj_solver #(.N(2), .P(2), .DEEP(0)) kernel (
          .clk, .rst_n, .s_tvalid, .s_tready(ready[i]), .s_tdata({sign, 8'h7F, 19'd0, word}), .m_tvalid(valid[i]),
          .m_tready, .m_tdata(data[i]), .m_tlast(last[i]), .err(err[i]), .cycles(cycles[i])
      );
    end
  endgenerate
  always_ff @(posedge clk) if (rst_n) begin
    assert (ready[0] == ready[1]);
    assert (valid[0] == valid[1]);
    if (valid[0]) assert ((last[0] == last[1]) && (cycles[0] == cycles[1]));
    cover (valid[0] & last[0]);
  end
endmodule

module formal_reset_mass (input logic clk, s_tvalid, m_tready, input logic [3:0] word);
  logic [1:0]  ready, valid, last;
  logic [31:0] data [0:1];
  logic        rst_n = 1'b0;
  always_ff @(posedge clk) rst_n <= 1'b1;
  genvar i;
  generate
    for (i = 0; i < 2; i = i + 1) begin : one
      body_mass #(.ROWS(1), .DEEP(0)) kernel (
          .clk, .rst_n, .s_tvalid, .s_tready(ready[i]), .s_tdata({28'h3F80000, word}), .m_tvalid(valid[i]), .m_tready,
          .m_tdata(data[i]), .m_tlast(last[i]), .err(), .cycles()
      );
    end
  endgenerate
  always_ff @(posedge clk) if (rst_n) begin
    assert (ready[0] == ready[1]);
    assert (valid[0] == valid[1]);
    if (valid[0]) assert (last[0] == last[1]);
    cover (valid[0] & last[0]);
  end
endmodule
