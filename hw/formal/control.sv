// controlled_kernel around a kernel of three words in and two out. Whatever the processor writes and
// reads, whenever it aborts or resets, and however long the packets are that come: no packet is mixed with another, none
// of a wrong length gives a result, be that one the kernel's or one that a program has, a result leaves whole and in its order, and no `valid` drops before its `ready`.
module chosen_kernel #(parameter int NUMBER = 1) (
    input logic clk, rst_n, s_tvalid, s_tuser, m_tready, input logic [31:0] s_tdata,
    output logic s_tready, s_ends, m_tvalid, m_tlast, err, output logic [31:0] m_tdata, cycles
);
  // Words are {number of their packet, place in it}; coefficients are two words.
  logic [1:0]  state, at;  // 0 load, 1 run, 2 out
  logic [29:0] packet;
  (* anyseq *) logic ends;
  // Programs, of kernel 5, have two or three words, as the number of their packet is even or odd.
  wire last = (NUMBER == 5) ? (at == (s_tdata[2] ? 2'd2 : 2'd1)) : (at == (s_tuser ? 2'd1 : 2'd2));
  assign s_ends = last;
  assign s_tready = (state == 2'd0);
  assign m_tvalid = (state == 2'd2);
  assign m_tlast = at[0];
  assign m_tdata = {packet, at};
  assign err = 1'b0;
  assign cycles = 32'd0;
  always_ff @(posedge clk)
    if (!rst_n) begin
      state <= 2'd0; at <= 2'd0;
    end else if (s_tvalid & s_tready) begin
      assert (s_tdata[1:0] == at);
      if (at != 2'd0) assert (s_tdata[31:2] == packet);
      packet <= s_tdata[31:2];
      at <= last ? 2'd0 : at + 2'd1;
      if (~s_tuser & last) state <= 2'd1;
    end else if (state == 2'd1) begin
      if (ends) state <= 2'd2;
    end else if (m_tvalid & m_tready) begin
      at <= at + 2'd1;
      if (at == 2'd1) begin
        state <= 2'd0; at <= 2'd0;
      end
    end
endmodule

module formal_programs (
    input logic clk, rst_n, s_tvalid, m_tready, s_tlast, awvalid, wvalid, bready, arvalid, rready,
    input logic [6:0] awaddr, araddr, input logic [31:0] wdata
);
  formal_control #(.NUMBER(5), .WORDS_IN(0), .TABLE_WORDS(0)) it (.*);
endmodule

module formal_control #(parameter int NUMBER = 3, WORDS_IN = 3, TABLE_WORDS = 2) (
    input logic clk, rst_n, s_tvalid, m_tready, s_tlast, awvalid, wvalid, bready, arvalid, rready,
    input logic [6:0] awaddr, araddr, input logic [31:0] wdata
);
  logic        awready, wready, bvalid, arready, rvalid, irq, s_tready, m_tvalid, m_tlast;
  logic [1:0]  bresp, rresp;
  logic [31:0] rdata, m_tdata;
  logic        in_soft_reset, is_idle;
  logic [31:0] result_count, aborted_count, malformed_count;
  logic [29:0] packet = '0;
  logic [1:0]  place = '0;
  // A word says its place up to 3, which no packet of the right length has.
  controlled_kernel #(.NUMBER(NUMBER), .WORDS_IN(WORDS_IN), .TABLE_WORDS(TABLE_WORDS)) dut (
      .clk, .rst_n, .s_axi_awaddr(awaddr), .s_axi_awvalid(awvalid), .s_axi_awready(awready), .s_axi_wdata(wdata),
      .s_axi_wvalid(wvalid), .s_axi_wready(wready), .s_axi_bresp(bresp), .s_axi_bvalid(bvalid), .s_axi_bready(bready),
      .s_axi_araddr(araddr), .s_axi_arvalid(arvalid), .s_axi_arready(arready), .s_axi_rdata(rdata),
      .s_axi_rresp(rresp), .s_axi_rvalid(rvalid), .s_axi_rready(rready), .irq, .in_soft_reset, .is_idle,
      .result_count, .aborted_count, .malformed_count, .s_tvalid, .s_tready,
      .s_tdata({packet, place}), .s_tlast, .m_tvalid, .m_tready, .m_tdata, .m_tlast
  );
  wire reset = ~rst_n | in_soft_reset;
  logic started = 1'b0;
  logic out = 1'b0;  // place of the next word of a result
  always_ff @(posedge clk) begin
    started <= 1'b1;
    if (!started) assume (~rst_n);
    // The DMA holds a word until it is taken, and begins a new packet after its reset, which is that of the kernel.
    if (started && $past(s_tvalid & ~s_tready & ~reset)) assume (s_tvalid & (s_tlast == $past(s_tlast)));
    if (reset) begin
      place <= 2'd0; packet <= packet + 30'd1; out <= 1'b0;
    end else begin
      if (s_tvalid & s_tready) begin
        place <= s_tlast ? 2'd0 : (place == 2'd3) ? 2'd3 : place + 2'd1;
        if (s_tlast) packet <= packet + 30'd1;
      end
      if (m_tvalid & m_tready) begin
        assert (m_tdata[0] == out);
        assert (m_tlast == out);
        out <= ~out;
      end
    end
    if (started && $past(rst_n) && rst_n) begin
      if ($past(bvalid & ~bready)) assert (bvalid);
      if ($past(rvalid & ~rready)) assert (rvalid && (rdata == $past(rdata)));
      if (!$past(in_soft_reset) && $past(m_tvalid & ~m_tready))
        assert (m_tvalid && (m_tdata == $past(m_tdata)) && (m_tlast == $past(m_tlast)));
    end
    if (started && $past(reset)) assert (~s_tready & ~m_tvalid & is_idle);
    if (started && rst_n) begin
      cover (result_count == 32'd1);
      cover (malformed_count == 32'd1 && result_count == 32'd1);
      cover (aborted_count == 32'd1 && result_count == 32'd1);
    end
  end
endmodule
