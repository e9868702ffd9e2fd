// A kernel that a processor starts and reads through registers (register_map.sv): AXI4-Lite for control, AXI4-Stream
// in and out for words, and an interrupt.
//
// A start opens the stream for the words of one request, or, in mode `table`, for the coefficients; no other word is
// taken. The result leaves as the kernel gives it. Coefficients have no result: they are done when they are in.
// AXI4-Lite: address and data of a write may come in any order; one write and one read at a time.
module controlled_kernel
  import register_map::*;
#(
    parameter int NUMBER = 1
) (
    input  logic        clk,
    input  logic        rst_n,
    input  logic [5:0]  s_axi_awaddr,
    input  logic        s_axi_awvalid,
    output logic        s_axi_awready,
    input  logic [31:0] s_axi_wdata,
    input  logic        s_axi_wvalid,
    output logic        s_axi_wready,
    output logic [1:0]  s_axi_bresp,
    output logic        s_axi_bvalid,
    input  logic        s_axi_bready,
    input  logic [5:0]  s_axi_araddr,
    input  logic        s_axi_arvalid,
    output logic        s_axi_arready,
    output logic [31:0] s_axi_rdata,
    output logic [1:0]  s_axi_rresp,
    output logic        s_axi_rvalid,
    input  logic        s_axi_rready,
    output logic        irq,
    input  logic        s_tvalid,
    output logic        s_tready,
    input  logic [31:0] s_tdata,
    output logic        m_tvalid,
    input  logic        m_tready,
    output logic [31:0] m_tdata,
    output logic        m_tlast
);
  logic start, done, ready, again, open, busy, global_enable, of_table, table_mode;
  logic [1:0]  enabled, happened;
  logic [31:0] left, clocks, compute, link, requests, kernel_cycles;
  logic        kernel_ready, kernel_err, kernel_last, refused;

  chosen_kernel #(.NUMBER(NUMBER)) kernel (
      .clk, .rst_n, .s_tvalid(s_tvalid & open), .s_tuser(of_table), .s_tdata, .s_tready(kernel_ready),
      .m_tvalid, .m_tready, .m_tdata, .m_tlast(kernel_last), .err(kernel_err), .cycles(kernel_cycles)
  );
  assign s_tready = kernel_ready & open;
  assign m_tlast = kernel_last;
  wire taken = s_tvalid & s_tready;
  wire all_in = taken & (left == 32'd1);
  wire all_out = m_tvalid & m_tready & kernel_last;
  wire ended = all_out | (all_in & of_table);

  // One write and one read at a time.
  logic [5:0]  at;
  logic [31:0] word;
  logic        have_address, have_word;
  assign s_axi_awready = ~have_address & ~s_axi_bvalid;
  assign s_axi_wready = ~have_word & ~s_axi_bvalid;
  assign s_axi_bresp = 2'b00;
  assign s_axi_rresp = 2'b00;
  assign s_axi_arready = ~s_axi_rvalid;
  wire writes = have_address & have_word & ~s_axi_bvalid;
  wire reads = s_axi_arvalid & s_axi_arready;
  wire reads_control = reads & (s_axi_araddr == CONTROL);
  assign irq = global_enable & |(happened & enabled);

  always_ff @(posedge clk) begin
    if (!rst_n) begin
      have_address <= 1'b0; have_word <= 1'b0; s_axi_bvalid <= 1'b0; s_axi_rvalid <= 1'b0;
      start <= 1'b0; done <= 1'b0; ready <= 1'b0; again <= 1'b0; open <= 1'b0; busy <= 1'b0;
      global_enable <= 1'b0; enabled <= '0; happened <= '0; of_table <= 1'b0; table_mode <= 1'b0; refused <= 1'b0;
      left <= '0; clocks <= '0; compute <= '0; link <= '0; requests <= '0;
    end else begin
      if (s_axi_awvalid & s_axi_awready) begin have_address <= 1'b1; at <= s_axi_awaddr; end
      if (s_axi_wvalid & s_axi_wready) begin have_word <= 1'b1; word <= s_axi_wdata; end
      if (s_axi_bvalid & s_axi_bready) s_axi_bvalid <= 1'b0;
      if (s_axi_rvalid & s_axi_rready) s_axi_rvalid <= 1'b0;

      // The work.
      if (reads_control) begin done <= 1'b0; ready <= 1'b0; end
      if (start & ~busy) begin
        busy <= 1'b1; open <= 1'b1; clocks <= '0;
        of_table <= table_mode & (table_words_of(NUMBER) != 0);
        left <= (table_mode & (table_words_of(NUMBER) != 0)) ? table_words_of(NUMBER) : words_in_of(NUMBER);
      end
      if (busy) clocks <= clocks + 1'b1;
      if (taken) left <= left - 1'b1;
      if (all_in) begin
        open <= 1'b0; ready <= 1'b1; start <= again;
        happened[INTERRUPT_STATUS_READY] <= 1'b1;
      end
      if (ended) begin
        busy <= 1'b0; done <= 1'b1; requests <= requests + 1'b1;
        happened[INTERRUPT_STATUS_DONE] <= 1'b1;
        refused <= of_table ? 1'b0 : kernel_err;
        compute <= of_table ? '0 : kernel_cycles;
        link <= of_table ? clocks + 1'b1 : clocks + 1'b1 - kernel_cycles;
      end

      if (writes) begin
        have_address <= 1'b0; have_word <= 1'b0; s_axi_bvalid <= 1'b1;
        case (at)
          CONTROL: begin
            if (word[CONTROL_START]) start <= 1'b1;
            again <= word[CONTROL_AUTO_RESTART];
          end
          GLOBAL_INTERRUPT: global_enable <= word[GLOBAL_INTERRUPT_ENABLE];
          INTERRUPT_ENABLE: enabled <= word[1:0];
          INTERRUPT_STATUS: happened <= (happened ^ word[1:0]) | {all_in, ended};  // no event is lost
          MODE: table_mode <= word[MODE_TABLE];
          default: ;
        endcase
      end
      if (reads) begin
        s_axi_rvalid <= 1'b1;
        case (s_axi_araddr)
          CONTROL: s_axi_rdata <= {24'd0, again, 3'd0, ready, ~busy & ~start, done, start};
          GLOBAL_INTERRUPT: s_axi_rdata <= {31'd0, global_enable};
          INTERRUPT_ENABLE: s_axi_rdata <= {30'd0, enabled};
          INTERRUPT_STATUS: s_axi_rdata <= {30'd0, happened};
          KERNEL: s_axi_rdata <= NUMBER;
          MAP_VERSION: s_axi_rdata <= map_version_of(NUMBER);
          SIZE: s_axi_rdata <= size_of(NUMBER);
          WORDS_IN: s_axi_rdata <= words_in_of(NUMBER);
          WORDS_OUT: s_axi_rdata <= words_out_of(NUMBER);
          TABLE_WORDS: s_axi_rdata <= table_words_of(NUMBER);
          MODE: s_axi_rdata <= {31'd0, table_mode};
          STATUS: s_axi_rdata <= refused ? STATUS_PIVOT : STATUS_OK;
          COMPUTE_CYCLES: s_axi_rdata <= compute;
          LINK_CYCLES: s_axi_rdata <= link;
          REQUESTS: s_axi_rdata <= requests;
          default: s_axi_rdata <= '0;
        endcase
      end
    end
  end
endmodule
