// Kinematics of four wheels from tables: x, y, camber, toe, caster and spring of each as a polynomial in travel and
// steering, with its first derivative, half its second, and its rate.
//
//   p(xi, eta) = sum_i xi^i sum_j c_ij eta^j       i < 6, j < 7 in front; rear wheels do not steer: j = 0
//
// One unit is a product and a sum. It does the Horner schemes of a column of a front wheel and of a rear one: first of
// the six rows in eta, then of value, slope and half curvature in xi of both wheels, six chains at a time, as many
// clocks apart as the sum comes back after. With U units, each does 12 / U such pairs one after the other.
//
// A reset keeps coefficients that have come whole. Without them, as after a reset in the middle of them, every word that
// leaves is a NaN, and `err` is set until they have come.
//
// AXI4-Stream in. With s_tuser the words are coefficients, kept for all requests: of each pair (fl x … fl spring,
// fr x … fr spring, with the same of rl and rr) c_00 c_01 … c_56 of the front wheel and c_0 … c_5 of the rear one, 48
// words. Without: of each wheel fl fr rl rr xi, eta, and the rate of xi. Out: of each wheel and column value, slope,
// half curvature, rate, 96 words.
module suspension_motion #(
    parameter int U = 12,
    parameter bit DEEP = 1'b1
) (
    input  logic        clk,
    input  logic        rst_n,
    input  logic        s_tvalid,
    output logic        s_tready,
    input  logic        s_tuser,
    input  logic [31:0] s_tdata,
    output logic        m_tvalid,
    input  logic        m_tready,
    output logic [31:0] m_tdata,
    output logic        m_tlast,
    output logic        err,
    output logic [31:0] cycles
);
  localparam int G = 12 / U;                    // pairs of a unit
  localparam int GB = (G > 1) ? $clog2(G) : 1;
  localparam int LM = DEEP ? 5 : 3, LA = DEEP ? 6 : 5;
  localparam int T = LM + LA + 1;               // clocks of a step
  localparam int INNER = 6, OUTER = 5;          // steps; one more for the rates
  localparam int STEPS = INNER + OUTER + 1;
  typedef enum logic [1:0] {LOAD, RUN, OUT} state_t;
  state_t st;

  logic [3:0]  pair;                            // being loaded
  logic [5:0]  word;
  logic [3:0]  at;                              // word of the request
  logic [31:0] xi [0:3], eta [0:3], rate [0:3];
  logic [3:0]  phase, step;
  logic [GB-1:0] group;
  logic [6:0]  out;
  wire         last_phase = (phase == 4'(T - 1));
  wire         last_step = (step == 4'(STEPS));  // one step beyond, while the rates leave
  wire         last_group = (group == GB'(G - 1));
  assign s_tready = (st == LOAD);
  logic whole = 1'b0;                           // all coefficients are there
  assign err = ~whole;
  always_ff @(posedge clk)
    if (rst_n & (st == LOAD) & s_tvalid & s_tuser) whole <= (word == 6'd47) & (pair == 4'd11);
  always_ff @(posedge clk) begin
    if (!rst_n) begin
      st <= LOAD; pair <= '0; word <= '0; at <= '0; phase <= '0; step <= '0; group <= '0; out <= '0; cycles <= '0;
    end else begin
      if (st == RUN) cycles <= cycles + 1'b1;
      case (st)
        LOAD: if (s_tvalid) begin
          cycles <= '0;
          if (s_tuser) begin
            word <= (word == 6'd47) ? 6'd0 : word + 1'b1;
            if (word == 6'd47) pair <= (pair == 4'd11) ? 4'd0 : pair + 1'b1;
          end else begin
            at <= (at == 4'd11) ? 4'd0 : at + 1'b1;
            if (at == 4'd11) st <= RUN;
          end
        end
        RUN: begin
          phase <= last_phase ? 4'd0 : phase + 1'b1;
          if (last_phase) step <= step + 1'b1;
          if (ends) begin
            phase <= '0; step <= '0;
            group <= following;
            if (last_group) st <= OUT;
          end
        end
        OUT: if (m_tready) begin
          out <= m_tlast ? 7'd0 : out + 1'b1;
          if (m_tlast) st <= LOAD;
        end
        default: st <= LOAD;
      endcase
    end
  end
  // Words of the table are addressed and read before they are needed. A chain begins with the last column of its row in
  // front, c_5 at the rear: chain c of the inner steps is row 5 - c. Seven times a number is eight times it less itself:
  // a product would take a multiplier of its own, which was the slowest of all on ECP5.
  wire         begins = (st == LOAD) & s_tvalid & ~s_tuser & (at == 4'd11);
  wire         ends = last_step & (phase == 4'd6);
  wire [GB-1:0] following = last_group ? '0 : group + 1'b1;
  logic [9:0]  begin_at, add_at;                // group, word
  logic [2:0]  row_at;
  always_ff @(posedge clk)
    if (begins) begin_at <= {4'd0, 6'(4 * 7 + 6)};
    else if (st != RUN) begin_at <= {4'd0, 6'(5 * 7 + 6)};
    else if (ends) begin_at <= {4'(following), 6'(4 * 7 + 6)};
    else if (last_step | (last_phase & (step == 4'(STEPS - 1)))) begin_at <= {4'(following), 6'(5 * 7 + 6)};
    else if ((step == 4'd0) & ~last_phase) begin_at <= {4'(group), 6'(6'd27 - {phase[2:0], 3'd0} + 6'(phase))};
    else begin_at <= {4'(group), 6'd47};

  wire [1:0] corner = (at < 4'd3) ? 2'd0 : (at < 4'd6) ? 2'd1 : (at < 4'd9) ? 2'd2 : 2'd3;
  wire [1:0] part = 2'(at - 4'd3 * corner);
  always_ff @(posedge clk)
    if (st == LOAD & s_tvalid & ~s_tuser) begin
      if (part == 2'd0) xi[corner] <= s_tdata;
      if (part == 2'd1) eta[corner] <= s_tdata;
      if (part == 2'd2) rate[corner] <= s_tdata;
    end

  // What goes along with an operand: step, chain, group.
  wire inner = (step < 4'(INNER));
  wire used = (phase < 4'd6) & (st == RUN) & (step < 4'(STEPS));
  logic [8+GB:0] side [1:T];
  always_ff @(posedge clk) begin
    side[1] <= {used & rst_n, step, phase, group};
    for (int i = 2; i <= T; i = i + 1) side[i] <= side[i-1] & {(9+GB){rst_n}};
  end
  wire          sum_valid; wire [3:0] sum_step, sum_chain, add_step, add_chain, soon_step, soon_chain;
  wire [GB-1:0] sum_group, soon_group;
  assign {sum_valid, sum_step, sum_chain, sum_group} = side[T];
  assign {add_step, add_chain} = side[LM][7+GB:GB];
  assign {soon_step, soon_chain, soon_group} = side[LM-2][7+GB:0];
  always_ff @(posedge clk) begin
    add_at <= {4'(soon_group), (soon_step < 4'(INNER)) ? 6'(6'd40 - {soon_chain[2:0], 3'd0} + 6'(soon_chain) - 6'(soon_step))
                                                       : 6'(6'd46 - (6'(soon_step) - 6'(INNER)))};
    row_at <= 3'(4'(INNER + 4) - soon_step);
  end

  // Results of all units, by unit: pair of the unit × (chain, or rate of slope).
  logic [31:0] left [0:U-1];
  wire [6:0] of_wheel = (out >= 7'd72) ? out - 7'd72 : (out >= 7'd48) ? out - 7'd48 : (out >= 7'd24) ? out - 7'd24 : out;
  wire       out_right = ((out >= 7'd24) & (out < 7'd48)) | (out >= 7'd72);
  wire       out_rear = (out >= 7'd48);
  wire [3:0] out_pair = 4'(of_wheel[6:2]) + (out_right ? 4'd6 : 4'd0);
  wire [2:0] out_slot = (of_wheel[1:0] == 2'd3) ? (out_rear ? 3'd7 : 3'd6)
                                                : 3'(of_wheel[1:0]) + (out_rear ? 3'd3 : 3'd0);
  assign m_tvalid = (st == OUT);
  assign m_tlast = (out == 7'd95);
  assign m_tdata = whole ? left[(U == 1) ? 0 : out_pair % U] : 32'h7FC0_0000;

  genvar u;
  generate
    for (u = 0; u < U; u = u + 1) begin : unit
      // Pair g of this unit is pair g U + u.
      logic [31:0] table_ [0:64*(1<<((G > 1) ? GB : 0))-1];
      logic [31:0] rows [0:7];
      logic [31:0] kept [0:8*(1<<((G > 1) ? GB : 0))-1];
      wire [3:0] pair_now = 4'(group) * 4'(U) + 4'(u);
      wire       right = (pair_now >= 4'd6);
      wire       mine = (U == 1) | ((pair % U) == u);
      wire [3:0] pair_group = pair / U;
      always_ff @(posedge clk)
        if (st == LOAD & s_tvalid & s_tuser & mine) table_[{pair_group, word}] <= s_tdata;

      // Operands: what came back from the sum, or what a chain begins with.
      wire  [31:0] product, sum;
      logic [31:0] a, b, begin_with;
      logic [31:0] from_table;
      always_ff @(posedge clk) from_table <= table_[begin_at];
      always_comb begin
        if (step == 4'd0) begin_with = from_table;
        else if (phase == 4'd0) begin_with = sum;  // row 5, which leaves the sum just now
        else if (phase == 4'd3) begin_with = from_table;
        else begin_with = 32'd0;
      end
      wire fresh = (step == 4'd0) | (step == 4'(INNER));
      wire rear = (phase >= 4'd3);
      wire [1:0] wheel = {rear, right};
      always_ff @(posedge clk) begin
        a <= fresh ? begin_with : sum;
        b <= inner ? eta[{1'b0, right}] : (step == 4'(INNER + OUTER)) ? rate[wheel] : xi[wheel];
      end
      fp32_mul #(.DEEP(DEEP)) u_m (.clk, .a, .b, .y(product));

      // Addends: a coefficient, or what the chain before held.
      logic [31:0] held [0:LM];
      logic [31:0] add_table, add_row;
      always_ff @(posedge clk) begin
        add_table <= table_[add_at];
        add_row <= rows[row_at];
      end
      logic [31:0] addend;
      always_ff @(posedge clk) begin
        held[0] <= a;
        for (int i = 1; i <= LM; i = i + 1) held[i] <= held[i-1];
        addend <= (add_step < 4'(INNER)) ? add_table
                : (add_step == 4'(INNER + OUTER)) ? 32'd0
                : (add_chain == 4'd0) ? add_row
                : (add_chain == 4'd3) ? add_table
                : held[LM-1];
      end
      fp32_add #(.DEEP(DEEP)) u_a (.clk, .a(product), .b(addend), .y(sum));

      wire rates = (sum_step == 4'(STEPS - 1));
      always_ff @(posedge clk) begin
        if (sum_valid & (sum_step == 4'(INNER - 1))) rows[3'd5 - sum_chain[2:0]] <= sum;
        if (sum_valid & (sum_step == 4'(STEPS - 2))) kept[{4'(sum_group), sum_chain[2:0]}] <= sum;
        else if (sum_valid & rates & (sum_chain == 4'd1)) kept[{4'(sum_group), 3'd6}] <= sum;
        else if (sum_valid & rates & (sum_chain == 4'd4)) kept[{4'(sum_group), 3'd7}] <= sum;
      end
      assign left[u] = kept[{4'(out_pair / U), out_slot}];
    end
  endgenerate
endmodule
