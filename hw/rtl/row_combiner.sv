// Sums of rows of a symmetric matrix that stays here: what a Kalman filter makes of its covariance. 128 rows of 64
// columns; the matrix is in the first 64, the others are for results on their way. L lanes, each with a product and a
// sum in every clock.
//
// A request is a program of 32-bit words, of which the last is END. The answer is the rows that END asks for, then the
// clocks from the first word to the last that leaves but itself.
//
//   31:29         28:23             22    21       20:14      13:7          6:0
//   0 SIZE                                                                  columns - 1
//   1 WRITE                                        rows - 1                 first row      the rows follow
//   2 COMBINE     last, first slot  own   keep     terms - 1  results - 1   first result   the terms follow
//   3 OUTER                                        rows - 1                 first row
//   4 MOVE                                column   rows - 1   first to      first from
//   5 POINT                                        points - 1                              the points follow
//   7 END                                          rows                     first row
//
// COMBINE: results y_i = (keep ? y_i : 0) + sum over terms of c_i x. A term is the row of x and one c for each result, of
// which there are L at most; with `own` the row of result i is that row + i. Of columns some slots are made, of L each. No
// result may be among the rows of the terms.
// OUTER: row i of the matrix, of all, becomes itself less the sum of v_k[i] v_k over the rows v_k.
// MOVE: rows become others, or columns of the matrix; a row of the matrix no column but its own.
// POINT: elements of the matrix grow; a point is a word with its column in 12:7 and its row in 6:0, and then a number. No
// element twice in an instruction.
//
// Element (i, j) is in lane (i + j) mod L, so that a row and a column each have L of their elements in L lanes: columns
// are written as fast as rows. Lanes stand as those of the result; what is read is turned to it on the way.
module row_combiner #(
    parameter int L = 16,
    parameter bit DEEP = 1'b1
) (
    input  logic        clk,
    input  logic        rst_n,
    input  logic        s_tvalid,
    output logic        s_tready,
    input  logic [31:0] s_tdata,
    output logic        s_ends,  // the word that is offered ends a program
    output logic        m_tvalid,
    input  logic        m_tready,
    output logic [31:0] m_tdata,
    output logic        m_tlast,
    output logic        err,     // an infinite number or a NaN was written into a column of the program
    output logic [31:0] cycles
);
  localparam int LB = $clog2(L);
  localparam int CB = 6 - LB;              // of a slot: L columns of a row
  localparam int AB = 7 + CB;
  localparam int LM = DEEP ? 5 : 3;
  localparam int LA = DEEP ? 6 : 5;
  localparam int X = 3;                    // stage in which what was read has been turned
  localparam int Y = X + LM;               // in which products and what they are added to meet
  localparam int Z = Y + LA;               // in which sums leave
  localparam int PERIOD = LA + 2;          // clocks after which a sum may be added to again
  localparam int GAP = 4;                  // clocks after which a row that was moved may be read

  typedef enum logic [2:0] {SIZE, WRITE, COMBINE, OUTER, MOVE, POINT, NONE, END} op_t;
  typedef enum logic [3:0] {DECODE, S_WRITE, S_READ, S_SHIFT, S_TERMS, S_MOVE, S_POINT, S_END} state_t;
  state_t st;

  // Registers of the instruction.
  logic [5:0]    size;                     // columns - 1
  logic [6:0]    row, dest;                // read or written; first result
  logic [6:0]    left;                     // rows or terms that are left, less 1
  logic [CB-1:0] ch, ch0, ch1;
  logic [LB-1:0] ln;
  logic          keep, own, column, outer, running;
  wire  [CB-1:0] chlast = size[5:LB];
  wire           take = s_tvalid & s_tready;

  // A term that waits, and the one that is worked on.
  logic [6:0]    next_row, term_row;
  logic [31:0]   next_c [0:L-1];
  logic [31:0]   term_c [0:L-1];
  logic [LB:0]   fetched;                  // words of the next term that are there: its row, then its numbers
  logic          ready, asked, first_term, final_term;
  logic [7:0]    unfetched;                // terms
  logic [6:0]    unstarted;                // terms, less 1
  logic [LB-1:0] results, d;               // less 1
  logic [CB-1:0] block;                    // of OUTER: which L rows of the matrix
  logic          issued;                   // all slots of the term
  logic [3:0]    age;
  logic [6:0]    outer_row, outer_count;

  // What is issued, and where it goes.
  typedef enum logic [1:0] {SUM, MOVED, OUT, NUMBERS} kind_t;
  localparam int SB = 2 + 7 + 7 + CB + 2 * LB + 5;
  kind_t         kind0;
  logic [6:0]    src0, dst0;
  logic [CB-1:0] ch0s;
  logic [LB-1:0] d0, only0;                // only0: the lane of a point
  logic          first0, keep0, final0, point0, column0;
  logic [SB-1:0] sb [1:Z];
  logic          v [0:Z];
  logic [31:0]   number0, number1, number2;  // that a row is multiplied by, on its way
  logic          busy;
  always_comb begin
    busy = 1'b0;
    for (int i = 0; i <= Z; i = i + 1) busy = busy | v[i];
  end

  always_comb begin
    case (st)
      DECODE: s_tready = ~busy;
      S_WRITE, S_POINT: s_tready = 1'b1;
      S_TERMS: s_tready = ~outer & ~ready & (unfetched != '0);
      default: s_tready = 1'b0;
    endcase
  end

  wire last_slot = running & ~issued & (ch == ch1) & (d == results);
  wire term_over = running & ((age >= 4'(PERIOD - 1)) | (issued & (age >= 4'(PERIOD - 1)))) & (issued | last_slot);
  wire start = (st == S_TERMS) & ready & (~running | term_over);
  wire [5:0] block_results = ((6'(block) == 6'(chlast))) ? 6'(size[LB-1:0]) : 6'(L - 1);

  logic [31:0] out [0:L-1];
  logic        out_there;

  always_ff @(posedge clk) begin
    if (!rst_n) begin
      st <= DECODE; running <= 1'b0; ready <= 1'b0; asked <= 1'b0; v[0] <= 1'b0; cycles <= '0;
      out_there <= 1'b0; issued <= 1'b0; size <= 6'd63; fetched <= '0;
    end else begin
      v[0] <= 1'b0; point0 <= 1'b0;
      if (st == DECODE && cycles == '0) cycles <= take ? 32'd1 : 32'd0;
      else if (st != S_END) cycles <= cycles + 1'b1;
      case (st)
        DECODE: if (take) begin
          row <= s_tdata[6:0]; dest <= s_tdata[6:0]; left <= s_tdata[20:14];
          ch <= '0; ln <= '0; keep <= s_tdata[21]; own <= s_tdata[22]; column <= s_tdata[21];
          ch0 <= s_tdata[23 +: CB]; ch1 <= s_tdata[23+CB +: CB];
          results <= s_tdata[7 +: LB];
          fetched <= '0; ready <= 1'b0; asked <= 1'b0; running <= 1'b0; issued <= 1'b0; outer <= 1'b0;
          first_term <= 1'b1; unfetched <= {1'b0, s_tdata[20:14]} + 8'd1; unstarted <= s_tdata[20:14];
          case (s_tdata[31:29])
            SIZE: size <= s_tdata[5:0];
            WRITE: st <= S_WRITE;
            COMBINE: st <= S_TERMS;
            OUTER: begin
              st <= S_TERMS; outer <= 1'b1; own <= 1'b0; keep <= 1'b1; block <= '0; dest <= '0;
              ch0 <= '0; ch1 <= chlast; next_row <= s_tdata[6:0]; outer_row <= s_tdata[6:0];
              outer_count <= s_tdata[20:14];
              results <= (chlast == '0) ? size[LB-1:0] : LB'(L - 1);
            end
            MOVE: begin
              st <= S_MOVE; dest <= s_tdata[13:7];
            end
            POINT: st <= S_POINT;
            default: begin
              left <= s_tdata[20:14] - 1'b1;
              st <= (s_tdata[20:14] == '0) ? S_END : S_READ;
            end
          endcase
        end

        S_WRITE: if (take) begin
          ln <= ln + 1'b1;
          if (ln == LB'(L - 1)) ch <= ch + 1'b1;
          if ({ch, ln} == size) begin
            ch <= '0; ln <= '0; row <= row + 1'b1; left <= left - 1'b1;
            if (left == '0) st <= DECODE;
          end
        end

        S_READ: begin  // one slot, then its words
          v[0] <= ~asked; asked <= 1'b1;
          kind0 <= OUT; src0 <= row; dst0 <= '0; ch0s <= ch;
          if (v[X]) begin
            st <= S_SHIFT; ln <= '0;
          end
        end
        S_SHIFT: if (m_tready) begin
          ln <= ln + 1'b1;
          if (({ch, ln} == size) | (ln == LB'(L - 1))) begin
            asked <= 1'b0; st <= S_READ; ch <= ch + 1'b1;
            if ({ch, ln} == size) begin
              ch <= '0; row <= row + 1'b1; left <= left - 1'b1;
              if (left == '0) st <= S_END;
            end
          end
        end

        S_TERMS: begin
          // The next term comes in words, or by one slot of a row.
          if (take) begin
            if (fetched == '0) next_row <= s_tdata[6:0];
            else next_c[LB'(fetched - 1'b1)] <= s_tdata;
            fetched <= fetched + 1'b1;
            if (fetched == {1'b0, results} + 1'b1) begin
              ready <= 1'b1; fetched <= '0; unfetched <= unfetched - 1'b1;
            end
          end
          if (outer & ~ready & ~asked & ~running) begin
            v[0] <= 1'b1; asked <= 1'b1;
            kind0 <= NUMBERS; src0 <= next_row; dst0 <= '0; ch0s <= block;
          end
          if (numbers_come) begin
            for (int i = 0; i < L; i = i + 1) next_c[i] <= {~x[i][31], x[i][30:0]};
            ready <= 1'b1;
          end
          // Slots of the term, result after result.
          age <= (age == 4'hF) ? age : age + 1'b1;
          if (running & ~issued) begin
            v[0] <= 1'b1;
            kind0 <= SUM; src0 <= own ? term_row + {{(7-LB){1'b0}}, d} : term_row; dst0 <= dest + {{(7-LB){1'b0}}, d};
            ch0s <= ch; d0 <= d; first0 <= first_term; keep0 <= keep; final0 <= final_term;
            number0 <= term_c[d];
            ch <= (ch == ch1) ? ch0 : ch + 1'b1;
            if (ch == ch1) d <= d + 1'b1;
            if (last_slot) issued <= 1'b1;
          end
          if (start) begin
            running <= 1'b1; issued <= 1'b0; ready <= 1'b0; asked <= 1'b0; age <= '0; d <= '0; ch <= ch0;
            term_row <= next_row;
            for (int i = 0; i < L; i = i + 1) term_c[i] <= next_c[i];
            first_term <= (unstarted == left); final_term <= (unstarted == '0);
            unstarted <= unstarted - 1'b1;
            next_row <= next_row + 1'b1;
          end else if (term_over) begin
            running <= 1'b0;
            if (final_term) begin
              if (outer & (block != chlast)) begin
                block <= block + 1'b1; dest <= dest + 7'(L); unstarted <= outer_count; next_row <= outer_row;
                results <= (block + 1'b1 == chlast) ? size[LB-1:0] : LB'(L - 1);
              end else st <= DECODE;
            end
          end
        end

        S_MOVE: begin
          if (~issued) begin
            v[0] <= 1'b1;
            kind0 <= MOVED; src0 <= row; dst0 <= dest; ch0s <= ch; column0 <= column;
            ch <= ch + 1'b1;
            if (ch == chlast) begin
              issued <= 1'b1; age <= '0;
            end
          end else begin
            age <= age + 1'b1;
            if (age == 4'(GAP - 1)) begin
              issued <= 1'b0; ch <= '0; row <= row + 1'b1; dest <= dest + 1'b1; left <= left - 1'b1;
              if (left == '0) st <= DECODE;
            end
          end
        end

        S_POINT: if (take) begin
          issued <= ~issued;               // here: whether the word is the number
          if (~issued) begin
            row <= s_tdata[6:0]; ch <= s_tdata[7+LB +: CB]; ln <= s_tdata[7 +: LB] + s_tdata[0 +: LB];
          end else begin
            v[0] <= 1'b1; number0 <= s_tdata;
            kind0 <= SUM; src0 <= row; dst0 <= row; ch0s <= ch;
            first0 <= 1'b1; keep0 <= 1'b1; final0 <= 1'b1; point0 <= 1'b1; only0 <= ln;
            left <= left - 1'b1;
            if (left == '0) st <= DECODE;
          end
        end

        S_END: if (m_tready) begin
          st <= DECODE; cycles <= '0;
        end
        default: st <= DECODE;
      endcase
    end
  end

  // Stage by stage; what is not a sum ends where it has been turned.
  wire [1:0] kind1, kindx; wire [6:0] src1, dst1, dstx, dstk, dstz; wire [CB-1:0] chx, chk, chy, chz;
  wire [LB-1:0] dy, dz, onlyz; wire point2, columnx, firsty, keepy, finalz, pointz;
  localparam int AT_ONLY = 0, AT_POINT = LB, AT_COLUMN = AT_POINT + 1, AT_FINAL = AT_POINT + 2;
  localparam int AT_KEEP = AT_POINT + 3, AT_FIRST = AT_POINT + 4, AT_D = AT_POINT + 5, AT_CH = AT_D + LB;
  localparam int AT_DST = AT_CH + CB, AT_SRC = AT_DST + 7, AT_KIND = AT_SRC + 7;
  assign kind1 = sb[1][AT_KIND +: 2];
  assign src1 = sb[1][AT_SRC +: 7];
  assign dst1 = sb[1][AT_DST +: 7];
  assign point2 = sb[2][AT_POINT];
  assign kindx = sb[X][AT_KIND +: 2];
  assign dstx = sb[X][AT_DST +: 7];
  assign chx = sb[X][AT_CH +: CB];
  assign columnx = sb[X][AT_COLUMN];
  assign dstk = sb[Y-2][AT_DST +: 7];
  assign chk = sb[Y-2][AT_CH +: CB];
  assign firsty = sb[Y-1][AT_FIRST];
  assign keepy = sb[Y-1][AT_KEEP];
  assign dy = sb[Y-1][AT_D +: LB];
  assign chy = sb[Y-1][AT_CH +: CB];
  assign dstz = sb[Z][AT_DST +: 7];
  assign chz = sb[Z][AT_CH +: CB];
  assign dz = sb[Z][AT_D +: LB];
  assign finalz = sb[Z][AT_FINAL];
  assign pointz = sb[Z][AT_POINT];
  assign onlyz = sb[Z][AT_ONLY +: LB];
  always_ff @(posedge clk) begin
    sb[1] <= {kind0, src0, dst0, ch0s, d0, first0, keep0, final0, column0, point0, only0};
    for (int i = 2; i <= Z; i = i + 1) sb[i] <= sb[i-1];
    for (int i = 1; i <= Z; i = i + 1) v[i] <= rst_n & v[i-1] & ((i != X + 1) | (kindx == SUM));
  end

  // Lanes.
  wire numbers_come = v[X] & (kindx == NUMBERS);
  logic [31:0] a1 [0:L-1];
  logic [31:0] a2 [0:L-1];
  logic [31:0] x [0:L-1];
  logic [31:0] z [0:L-1];
  wire [LB-1:0] turn1 = (kind1 == MOVED || kind1 == SUM) ? dst1[LB-1:0] - src1[LB-1:0] : LB'(0) - src1[LB-1:0];
  wire [LB-1:0] coarse = {turn1[LB-1:2], 2'b00};
  logic [1:0]   fine2;
  always_ff @(posedge clk) begin
    fine2 <= turn1[1:0];
    for (int l = 0; l < L; l = l + 1) begin
      a2[l] <= a1[(l - 32'(coarse)) & (L - 1)];
      x[l] <= point2 ? 32'h3F80_0000 : a2[(l - 32'(fine2)) & (L - 1)];
    end
  end
  always_ff @(posedge clk) {number1, number2} <= {number0, number1};
  wire writing = (st == S_WRITE) & take;
  wire [LB-1:0] written = LB'(row) + ln;
  wire moved = v[X] & (kindx == MOVED);
  wire summed = v[Z] & finalz;
  logic [L-1:0] odd;

  genvar l;
  generate
    for (l = 0; l < L; l = l + 1) begin : lane
      logic [31:0] rows [0:(1<<AB)-1];     // two memories of the same, for two rows in a clock
      logic [31:0] same [0:(1<<AB)-1];
      logic [31:0] sums [0:63];
      logic [31:0] kept, y;
      logic [31:0] number;
      own_register #(.W(32)) u_own (.clk, .d(number2), .q(number));
      wire [LB-1:0] across = LB'(l) - dstx[LB-1:0];  // of the row that a column's element belongs to
      wire we = (writing & (written == LB'(l))) | moved | (summed & (~pointz | (onlyz == LB'(l))));
      wire [AB-1:0] wa = writing ? {row, ch}
                       : moved ? (columnx ? {1'b0, chx, across, dstx[5:LB]} : {dstx, chx})
                       : {dstz, chz};
      wire [31:0] wd = writing ? s_tdata : moved ? x[l] : z[l];
      always_ff @(posedge clk) begin
        if (we) begin
          rows[wa] <= wd;
          same[wa] <= wd;
        end
        a1[l] <= rows[{src0, ch0s}];
        kept <= same[{dstk, chk}];
      end
      wire [31:0] product;
      fp32_mul #(.DEEP(DEEP)) u_x (.clk, .a(x[l]), .b(number), .y(product));
      always_ff @(posedge clk) begin
        y <= ~firsty ? sums[{dy, chy}] : keepy ? kept : 32'd0;
        if (v[Z]) sums[{dz, chz}] <= z[l];
      end
      fp32_add #(.DEEP(DEEP)) u_s (.clk, .a(y), .b(product), .y(z[l]));
      // Slots are written whole: what is beyond the last column is no number of the program.
      wire [5:0] place = moved ? {chx, across} : {chz, LB'(l) - dstz[LB-1:0]};
      always_ff @(posedge clk) odd[l] <= we & (&wd[30:23]) & (writing | (place <= size));
    end
  endgenerate

  always_ff @(posedge clk) begin
    if (v[X] & (kindx == OUT)) for (int i = 0; i < L; i = i + 1) out[i] <= x[i];
    if (!rst_n) err <= 1'b0;
    else if (st == DECODE && cycles == '0) err <= 1'b0;
    else err <= err | (|odd);
  end

  assign s_ends = (st == DECODE) & (&s_tdata[31:30]);
  assign m_tvalid = (st == S_SHIFT) | (st == S_END);
  assign m_tdata = (st == S_END) ? cycles : out[ln];
  assign m_tlast = (st == S_END);
endmodule
