// A kernel that a processor starts and reads through registers (register_map.sv): AXI4-Lite for control, AXI4-Stream
// in and out for words, and an interrupt.
//
// A start opens the stream for one packet: the words of a request or, in mode `table`, of the coefficients, the last one
// marked. A request of a kernel without a number of words is a program, whose last word the kernel knows. No other word is taken. A packet of another length gives no result: what came of it is forgotten, its words
// are taken to the marked one, and the next start takes the next packet. `abort` gives up a request that is taken in or
// computed: the rest of its packet is taken and dropped, and a result that has begun to leave leaves whole. Where the
// rest of a packet will never come, `soft_reset`, a reset of one clock of all but this bus, begins anew. Any reset, of
// one clock or more, may come at any time; results of requests after it are right.
// AXI4-Lite: address and data of a write may come in any order; one write and one read at a time.
module controlled_kernel #(
    parameter int NUMBER = 1,
    parameter int WORDS_IN = register_map::words_in_of(NUMBER),
    parameter int TABLE_WORDS = register_map::table_words_of(NUMBER)
) (
    input  logic        clk,
    input  logic        rst_n,
    input  logic [register_map::ADDRESS_BITS-1:0] s_axi_awaddr,
    input  logic        s_axi_awvalid,
    output logic        s_axi_awready,
    input  logic [31:0] s_axi_wdata,
    input  logic        s_axi_wvalid,
    output logic        s_axi_wready,
    output logic [1:0]  s_axi_bresp,
    output logic        s_axi_bvalid,
    input  logic        s_axi_bready,
    input  logic [register_map::ADDRESS_BITS-1:0] s_axi_araddr,
    input  logic        s_axi_arvalid,
    output logic        s_axi_arready,
    output logic [31:0] s_axi_rdata,
    output logic [1:0]  s_axi_rresp,
    output logic        s_axi_rvalid,
    input  logic        s_axi_rready,
    output logic        irq,
`ifdef FORMAL
    output logic        in_soft_reset, is_idle,
    output logic [31:0] result_count, aborted_count, malformed_count,
`endif
    input  logic        s_tvalid,
    output logic        s_tready,
    input  logic [31:0] s_tdata,
    input  logic        s_tlast,
    output logic        m_tvalid,
    input  logic        m_tready,
    output logic [31:0] m_tdata,
    output logic        m_tlast
);
  logic start, done, ready, again, open, busy, dropping, global_enable, of_table, table_mode, abort, soft_reset, forget,
        begun, given_up;
  logic [1:0]  enabled, happened;
  logic [2:0]  status;
  logic [31:0] left, clocks, compute, link, requests, aborted, malformed, kernel_cycles;
  logic        ends;  // of a program, the word that is offered
  logic        kernel_ready, kernel_valid, kernel_err, kernel_last;

  wire reset = ~rst_n | soft_reset;
  wire last_due = (WORDS_IN == 0) ? ends : (left == 32'd1);
  wire fits = (s_tlast == last_due);
  chosen_kernel #(.NUMBER(NUMBER)) kernel (
      .clk, .rst_n(~(reset | forget)), .s_tvalid(s_tvalid & open & ~dropping & fits), .s_tuser(of_table), .s_tdata,
      .s_tready(kernel_ready), .s_ends(ends), .m_tvalid(kernel_valid), .m_tready, .m_tdata, .m_tlast(kernel_last), .err(kernel_err),
      .cycles(kernel_cycles)
  );
  assign s_tready = open & (dropping | kernel_ready);
  assign m_tvalid = kernel_valid & ~forget;
  assign m_tlast = kernel_last;
  wire taken = s_tvalid & s_tready;
  wire wrong = taken & ~dropping & ~fits;
  wire all_in = taken & ~dropping & fits & last_due;
  wire all_dropped = taken & s_tlast & (dropping | wrong);
  wire all_out = m_tvalid & m_tready & kernel_last;
  wire gives_up = abort & busy & ~m_tvalid & ~dropping & ~all_dropped;
  wire amid = open & (begun | taken) & ~(taken & s_tlast);  // the rest of a packet is still to come
  wire ended = all_out | (all_in & of_table) | all_dropped | (gives_up & ~amid);

`ifdef FORMAL
  assign {in_soft_reset, is_idle} = {soft_reset, ~busy & ~start};
  assign {result_count, aborted_count, malformed_count} = {requests, aborted, malformed};
`endif

  // One write and one read at a time.
  logic [register_map::ADDRESS_BITS-1:0] at;
  logic [31:0] word;
  logic        have_address, have_word;
  assign s_axi_awready = ~have_address & ~s_axi_bvalid;
  assign s_axi_wready = ~have_word & ~s_axi_bvalid;
  assign s_axi_bresp = 2'b00;
  assign s_axi_rresp = 2'b00;
  assign s_axi_arready = ~s_axi_rvalid;
  wire writes = have_address & have_word & ~s_axi_bvalid;
  wire reads = s_axi_arvalid & s_axi_arready;
  wire reads_control = reads & (s_axi_araddr == register_map::CONTROL);
  assign irq = global_enable & |(happened & enabled);

  always_ff @(posedge clk) begin
    if (!rst_n) begin
      have_address <= 1'b0; have_word <= 1'b0; s_axi_bvalid <= 1'b0; s_axi_rvalid <= 1'b0;
    end else begin
      if (s_axi_awvalid & s_axi_awready) begin have_address <= 1'b1; at <= s_axi_awaddr; end
      if (s_axi_wvalid & s_axi_wready) begin have_word <= 1'b1; word <= s_axi_wdata; end
      if (s_axi_bvalid & s_axi_bready) s_axi_bvalid <= 1'b0;
      if (s_axi_rvalid & s_axi_rready) s_axi_rvalid <= 1'b0;
      if (writes) begin have_address <= 1'b0; have_word <= 1'b0; s_axi_bvalid <= 1'b1; end
      if (reads) s_axi_rvalid <= 1'b1;
    end
  end

  always_ff @(posedge clk) begin
    soft_reset <= rst_n & writes & (at == register_map::CONTROL) & word[register_map::CONTROL_SOFT_RESET];
    forget <= ~reset & (wrong | gives_up);
    if (reset) begin
      start <= 1'b0; done <= 1'b0; ready <= 1'b0; again <= 1'b0; open <= 1'b0; busy <= 1'b0; dropping <= 1'b0;
      abort <= 1'b0; global_enable <= 1'b0; enabled <= '0; happened <= '0; of_table <= 1'b0; table_mode <= 1'b0;
      begun <= 1'b0; given_up <= 1'b0; status <= '0; left <= '0; clocks <= '0; compute <= '0; link <= '0;
      requests <= '0; aborted <= '0; malformed <= '0;
    end else begin
      // The work.
      abort <= 1'b0;
      if (reads_control) begin done <= 1'b0; ready <= 1'b0; end
      if (start & ~busy & ~forget & ~abort) begin
        busy <= 1'b1; open <= 1'b1; begun <= 1'b0; given_up <= 1'b0; clocks <= '0;
        of_table <= table_mode & (TABLE_WORDS != 0);
        left <= (table_mode & (TABLE_WORDS != 0)) ? TABLE_WORDS : WORDS_IN;
      end
      if (busy) clocks <= clocks + 1'b1;
      if (taken) begun <= 1'b1;
      if (taken & ~dropping) left <= left - 1'b1;
      if (wrong & ~s_tlast) dropping <= 1'b1;
      if (all_in | all_dropped) begin
        open <= 1'b0; dropping <= 1'b0;
        if (~given_up) begin
          ready <= 1'b1; start <= again;
          happened[register_map::INTERRUPT_STATUS_READY] <= 1'b1;
        end
      end
      if (all_out) requests <= requests + 1'b1;
      if (all_dropped & ~given_up) malformed <= malformed + 1'b1;
      if (ended) begin
        busy <= 1'b0; done <= 1'b1;
        happened[register_map::INTERRUPT_STATUS_DONE] <= 1'b1;
        status <= (gives_up | given_up) ? register_map::STATUS_FAULT : all_dropped ? register_map::STATUS_WRONG_SIZE
                : (all_out & kernel_err) ? register_map::refusal_of(NUMBER) : register_map::STATUS_OK;
        compute <= all_out ? kernel_cycles : '0;
        link <= all_out ? clocks + 1'b1 - kernel_cycles : clocks + 1'b1;
      end
      if (abort) start <= 1'b0;
      if (gives_up) begin
        open <= amid; dropping <= amid; given_up <= amid; aborted <= aborted + 1'b1;
      end

      if (writes) begin
        case (at)
          register_map::CONTROL: begin
            if (word[register_map::CONTROL_ABORT]) abort <= 1'b1;
            else if (word[register_map::CONTROL_START]) start <= 1'b1;
            again <= word[register_map::CONTROL_AUTO_RESTART];
          end
          register_map::GLOBAL_INTERRUPT: global_enable <= word[register_map::GLOBAL_INTERRUPT_ENABLE];
          register_map::INTERRUPT_ENABLE: enabled <= word[1:0];
          register_map::INTERRUPT_STATUS:  // no event is lost
            happened <= (happened ^ word[1:0]) | {(all_in | all_dropped) & ~given_up, ended};
          register_map::MODE: table_mode <= word[register_map::MODE_TABLE];
          default: ;
        endcase
      end
    end
    if (reads) begin
      case (s_axi_araddr)
        register_map::CONTROL: s_axi_rdata <= {24'd0, again, 3'd0, ready, ~busy & ~start & ~forget, done, start};
        register_map::GLOBAL_INTERRUPT: s_axi_rdata <= {31'd0, global_enable};
        register_map::INTERRUPT_ENABLE: s_axi_rdata <= {30'd0, enabled};
        register_map::INTERRUPT_STATUS: s_axi_rdata <= {30'd0, happened};
        register_map::KERNEL: s_axi_rdata <= NUMBER;
        register_map::MAP_VERSION: s_axi_rdata <= register_map::map_version_of(NUMBER);
        register_map::SIZE: s_axi_rdata <= register_map::size_of(NUMBER);
        register_map::WORDS_IN: s_axi_rdata <= WORDS_IN;
        register_map::WORDS_OUT: s_axi_rdata <= register_map::words_out_of(NUMBER);
        register_map::TABLE_WORDS: s_axi_rdata <= TABLE_WORDS;
        register_map::MODE: s_axi_rdata <= {31'd0, table_mode};
        register_map::STATUS: s_axi_rdata <= {29'd0, status};
        register_map::COMPUTE_CYCLES: s_axi_rdata <= compute;
        register_map::LINK_CYCLES: s_axi_rdata <= link;
        register_map::REQUESTS: s_axi_rdata <= requests;
        register_map::ABORTED: s_axi_rdata <= aborted;
        register_map::MALFORMED: s_axi_rdata <= malformed;
        default: s_axi_rdata <= '0;
      endcase
    end
  end
endmodule
