// Gauss-Jordan solver without divisions but the last (David 2017), N × N, one right-hand side, P lanes, for matrices
// whose pivots are positive without exchanging rows: symmetric positive definite ones, and those near them.
//
//   step k, each row i but k:   a_ij <- m_k a_ij - (a_ik / 2^e_k) a_kj      with a_kk = m_k 2^e_k, 1 <= m_k < 2
//   at the end:                 x_i = b_i / d_i                             d_i: a_ii times the m_k of all later steps
//
// The mantissa m_k instead of the whole pivot keeps the numbers within the range of binary32. Each lane holds every
// P-th column; a slot is one row's next P columns. A step begins with row k+1, which becomes the next pivot row: what
// leaves the adders of it is kept in `pr` besides memory, so that the next step may begin before it is read again.
//
// AXI4-Stream in, rows of N + 1 words [A | b]; out, x_0 … x_{N-1}. Where a pivot is not a positive normal number every
// word that leaves is a NaN, and `err` is set until the next system comes.
module gj_solver #(
    parameter int N = 14,
    parameter int P = 8,
    parameter bit DEEP = 1'b1  // deeper units: a higher clock, and some clocks more
) (
    input  logic        clk,
    input  logic        rst_n,
    input  logic        s_tvalid,
    output logic        s_tready,
    input  logic [31:0] s_tdata,
    output logic        m_tvalid,
    input  logic        m_tready,
    output logic [31:0] m_tdata,
    output logic        m_tlast,
    output logic        err,
    output logic [31:0] cycles  // from the last word that came to the last quotient
);
  localparam int W = N + 1;                      // columns
  localparam int C = (W + P - 1) / P;            // slots of a whole row
  localparam int RB = $clog2(N);
  localparam int CB = (C > 1) ? $clog2(C) : 1;
  localparam int LB = (P > 1) ? $clog2(P) : 1;
  localparam int AB = (C > 1) ? RB + CB : RB;
  localparam int LM = DEEP ? 5 : 3;              // clocks of a product
  localparam int LA = DEEP ? 6 : 5;              // of a sum
  localparam int LD = DEEP ? 16 : 15;            // of a quotient
  localparam int LAT = 3 + LM + LA;              // from issuing a slot to its result
  localparam int BL = N - (C - 1) * P;           // lane of column N, which is b

  typedef enum logic [1:0] {LOAD, RUN, DRAIN, OUT} state_t;
  state_t st;

  // Slots that a step must wait at its end, lest a row is read before it is written: it is read one place earlier in
  // the next step, whose slots for a row may be fewer by one.
  function automatic int waiting(input int slots, input bit fewer);
    int needed;
    needed = LAT + 1 + slots + (fewer ? N - 2 : 0) - (N - 1) * slots;
    waiting = (needed > 0) ? needed : 0;
  endfunction

  logic [RB-1:0] row, k, cnt;                    // row of the slot, pivot, rows issued in this step
  logic [CB-1:0] ch, kch;                        // slot of a row, first one of this step
  logic [LB-1:0] ln, kln;                        // lane being loaded, lane of column k
  logic [6:0]    wait_left;
  logic          waits;
  wire           lastch = (ch == CB'(C - 1));
  wire           lastk = (k == RB'(N - 1));
  wire           lastrow = (cnt == (lastk ? RB'(N - 1) : RB'(N - 2)));
  wire           firstrow = (cnt == '0);
  wire [RB-1:0]  rownext = (row == RB'(N - 1)) ? '0 : row + 1'b1;
  wire [RB-1:0]  knext = k + 1'b1;
  wire [RB-1:0]  knextnext = (knext == RB'(N - 1)) ? '0 : knext + 1'b1;
  wire           kwrap = (kln == LB'(P - 1));
  wire [CB-1:0]  kchnext = kwrap ? kch + 1'b1 : kch;
  wire           issue = (st == RUN) & ~waits;
  wire           ldcol = lastch & (ln == LB'(BL));
  logic [RB-1:0] xout;
  wire           xlast;

  logic [6:0] wait_now;
  always_comb begin
    wait_now = 7'd0;
    for (int c = 1; c <= C; c = c + 1)
      if (kch == CB'(C - c)) wait_now = 7'(kwrap ? waiting(c, 1'b1) : waiting(c, 1'b0));
  end

  assign s_tready = (st == LOAD);
  always_ff @(posedge clk) begin
    if (!rst_n) begin
      st <= LOAD; row <= '0; k <= '0; cnt <= '0; ch <= '0; kch <= '0; ln <= '0; kln <= '0;
      xout <= '0; cycles <= '0; waits <= 1'b0; wait_left <= '0;
    end else begin
      if (st == RUN || st == DRAIN) cycles <= cycles + 1'b1;
      case (st)
        LOAD: if (s_tvalid) begin
          cycles <= '0;
          if (ldcol) begin
            ln <= '0; ch <= '0; row <= rownext;
            if (row == RB'(N - 1)) begin
              st <= RUN; row <= RB'(1);
            end
          end else if (ln == LB'(P - 1)) begin
            ln <= '0; ch <= ch + 1'b1;
          end else ln <= ln + 1'b1;
        end
        RUN: if (waits) begin
          wait_left <= wait_left - 1'b1;
          if (wait_left == 7'd1) waits <= 1'b0;
        end else if (lastch) begin
          if (lastrow) begin
            cnt <= '0; k <= knext; kch <= kchnext; ch <= kchnext;
            kln <= kwrap ? '0 : kln + 1'b1;
            row <= knextnext;
            wait_left <= wait_now; waits <= (wait_now != 7'd0);
            if (lastk) begin
              st <= DRAIN; waits <= 1'b0;
            end
          end else begin
            cnt <= cnt + 1'b1; row <= rownext; ch <= kch;
          end
        end else ch <= ch + 1'b1;
        DRAIN: if (xlast) st <= OUT;
        OUT: if (m_tready) begin
          xout <= xout + 1'b1;
          if (xout == RB'(N - 1)) begin
            st <= LOAD; row <= '0; k <= '0; cnt <= '0; ch <= '0; kch <= '0; ln <= '0; kln <= '0;
            xout <= '0;
          end
        end
        default: st <= LOAD;
      endcase
    end
  end

  // What goes along with a slot.
  //   first: it belongs to row k+1     old: its row was the last step's pivot row     own: it is the pivot row itself,
  //   which happens in the last step alone     start: first slot of its row     last: last slot     final: last step
  // Whether there is a slot at all is cleared by the shortest reset: a slot that was on its way does not come to memory
  // in the next request. The rest of it is not looked at without that.
  localparam int SB = 7 + RB + CB;
  logic [LAT:1]  valid;
  logic [SB-1:0] sb [1:LAT];
  always_ff @(posedge clk) begin
    valid <= rst_n ? {valid[LAT-1:1], issue} : '0;
    sb[1] <= {firstrow & ~lastk, ~lastk ? lastrow : (cnt == RB'(N - 2)), lastk & (cnt == RB'(N - 1)),
              ch == kch, lastch, lastk, k[0], row, ch};
    for (int i = 2; i <= LAT; i = i + 1) sb[i] <= sb[i-1];
  end
  logic [LB-1:0] kln1;
  logic [CB-1:0] kchl;   // where the next pivot stands in its row
  logic [LB-1:0] klnl;
  always_ff @(posedge clk) begin
    kln1 <= kln;
    if (st == LOAD) begin
      kchl <= '0; klnl <= '0;
    end else if (issue & firstrow) begin
      kchl <= kchnext; klnl <= kwrap ? '0 : kln + 1'b1;
    end
  end
  wire v1, first1, old1, own1, start1, last1, final1, odd1; wire [RB-1:0] r1; wire [CB-1:0] c1;
  wire v2, first2, old2, own2, start2, last2, final2, odd2; wire [RB-1:0] r2; wire [CB-1:0] c2;
  wire vw, firstw, oldw, ownw, startw, lastw, finalw, oddw; wire [RB-1:0] rw; wire [CB-1:0] cw;
  assign {v1, v2, vw} = {valid[1], valid[2], valid[LAT]};
  assign {first1, old1, own1, start1, last1, final1, odd1, r1, c1} = sb[1];
  assign {first2, old2, own2, start2, last2, final2, odd2, r2, c2} = sb[2];
  assign {firstw, oldw, ownw, startw, lastw, finalw, oddw, rw, cw} = sb[LAT];

  function automatic [AB-1:0] addr(input [RB-1:0] r, input [CB-1:0] c);
    if (C > 1) addr = AB'({c, r}); else addr = AB'(r);
  endfunction

  // Pivots of this step and the next, by the parity of the step: mantissa and exponent.
  logic [32*P-1:0] res, rd;
  logic [22:0] pm [0:1];
  logic [7:0]  pe [0:1];
  wire         loading = (st == LOAD) & s_tvalid;
  wire         load_pivot = loading & (row == '0) & (ch == '0) & (ln == '0);
  wire         next_pivot = vw & firstw & (cw == kchl);
  wire [31:0]  pivot = (st == LOAD) ? s_tdata : res[32*klnl +: 32];
  always_ff @(posedge clk) begin
    if (load_pivot | next_pivot) begin
      pm[load_pivot ? 1'b0 : ~oddw] <= pivot[22:0];
      pe[load_pivot ? 1'b0 : ~oddw] <= pivot[30:23];
    end
    if (!rst_n) err <= 1'b0;
    else if (load_pivot) err <= pivot[31] | (pivot[30:23] == 8'd0) | (&pivot[30:23]);
    else if (next_pivot) err <= err | pivot[31] | (pivot[30:23] == 8'd0) | (&pivot[30:23]);
  end

  // Stage 1: rows as read. Stage 2: the element of column k. Stage 3: m_k, and -a_ik / 2^e_k.
  logic [31:0] cm, m3;
  wire [31:0] cmsel = rd[32*kln1 +: 32];
  always_ff @(posedge clk) if (start1) cm <= cmsel;
  wire [7:0] p2e = pe[odd2];
  wire [9:0] es = {2'b00, cm[30:23]} + {{3{p2e[7]}}, ~p2e[6:0]};  // + 127 - p2e
  wire       ctop = &cm[30:23];
  wire       czero = ~ctop & ((cm[30:23] == 8'd0) | es[9] | (es == 10'd0));
  wire       chigh = ~ctop & ~es[9] & (es[8] | (&es[7:0]));  // 255 or more
  // A factor of zero has its sign, too: its products are zeros, whose signs decide that of a sum of zeros.
  wire [31:0] factor = own2 ? 32'd0 : {~cm[31], czero ? 8'd0 : (ctop | chigh) ? 8'hFF : es[7:0],
                                       (czero | chigh) ? 23'd0 : cm[22:0]};
  wire [22:0] mantissa = own2 ? 23'd0 : pm[odd2];
  always_ff @(posedge clk) m3 <= {9'h07F, mantissa};

  // Lanes.
  genvar l;
  generate
    for (l = 0; l < P; l = l + 1) begin : lane
      logic [31:0] mem [0:(1<<AB)-1];
      logic [31:0] a1, a2, a3, pr3;
      // Each lane has m_k and the factor in registers of its own, beside its multipliers: from one register for all the
      // way to the farthest takes half a clock.
      logic [22:0] own_mantissa;
      logic [31:0] own_factor;
      own_register #(.W(55)) u_own (.clk, .d({mantissa, factor}), .q({own_mantissa, own_factor}));
      logic [31:0] pr [0:(2<<((C > 1) ? CB : 0))-1];
      wire          ldw = loading & (ln == LB'(l));
      wire          wbw = vw;
      wire [AB-1:0] wa = (st == LOAD) ? addr(row, ch) : addr(rw, cw);
      wire [31:0]   wd = (st == LOAD) ? s_tdata : res[32*l +: 32];
      wire [AB-1:0] ra = addr(row, ch);
      always_ff @(posedge clk) begin
        if (ldw | wbw) mem[wa] <= wd;
        a1 <= mem[ra];
        a2 <= a1;
        a3 <= a2;
      end
      assign rd[32*l +: 32] = a1;
      wire prw = (ldw & (row == '0)) | (vw & firstw);
      wire bank = (st == LOAD) ? 1'b0 : ~oddw;
      if (C > 1) begin : several
        always_ff @(posedge clk) begin
          if (prw) pr[{bank, (st == LOAD) ? ch : cw}] <= wd;
          pr3 <= pr[{odd2, c2}];
        end
      end else begin : one
        always_ff @(posedge clk) begin
          if (prw) pr[bank] <= wd;
          pr3 <= pr[odd2];
        end
      end
      wire [31:0] x, y;
      fp32_mul #(.DEEP(DEEP)) u_x (.clk, .a(a3), .b({9'h07F, own_mantissa}), .y(x));
      fp32_mul #(.DEEP(DEEP)) u_y (.clk, .a(pr3), .b(own_factor), .y(y));
      fp32_add #(.DEEP(DEEP)) u_s (.clk, .a(x), .b(y), .y(res[32*l +: 32]));
    end
  endgenerate

  // Diagonal: d_i <- m_k d_i, beginning with the pivot in the step after its own.
  logic [31:0] dmem [0:(1<<RB)-1];
  logic [31:0] d1, d2, d3, dold;
  wire  [31:0] dx;
  logic [31:0] dd [0:LA-1];
  always_ff @(posedge clk) begin
    if (vw & lastw) dmem[rw] <= dd[LA-1];
    d1 <= dmem[row];
    d2 <= d1;
    // The other bank holds the last step's pivot until this step's first row leaves the adders.
    if (v1 & start1 & ((first1) | (final1 & (r1 == '0)))) dold <= {1'b0, pe[~odd1], pm[~odd1]};
    d3 <= own2 ? cm : old2 ? dold : d2;
    dd[0] <= dx;
    for (int i = 1; i < LA; i = i + 1) dd[i] <= dd[i-1];
  end
  fp32_mul #(.DEEP(DEEP)) u_d (.clk, .a(d3), .b(m3), .y(dx));

  // Quotients.
  wire [31:0] xq;
  fp32_div #(.DEEP(DEEP)) u_q (.clk, .a(res[32*BL +: 32]), .b(dd[LA-1]), .y(xq));
  logic [RB:0] qs [1:LD];
  always_ff @(posedge clk) begin
    qs[1] <= {vw & lastw & finalw & rst_n, rw};
    for (int i = 2; i <= LD; i = i + 1) qs[i] <= qs[i-1] & {(RB+1){rst_n}};
  end
  logic [31:0] xmem [0:(1<<RB)-1];
  always_ff @(posedge clk) if (qs[LD][RB]) xmem[qs[LD][RB-1:0]] <= xq;
  assign xlast = qs[LD][RB] & (qs[LD][RB-1:0] == RB'(N - 1));
  assign m_tvalid = (st == OUT);
  assign m_tdata = err ? 32'h7FC0_0000 : xmem[xout];
  assign m_tlast = (xout == RB'(N - 1));
endmodule
