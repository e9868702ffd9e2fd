// Mass matrix of one rigid body about a reference point: R J Rᵀ (upper triangle) and m R s, of which the 6 × 6 matrix
// consists. R turns the body's axes into those of the reference, J is the inertia about the reference point in body
// axes, s the body's centre in body axes, m its mass.
//
// AXI4-Stream in, 19 words: R by rows, J as xx yy zz xy xz yz, s, m. Out, 9 words: xx xy xz yy yz zz of R J Rᵀ, then
// m R s. Phase A makes the rows of R [J | s], phase B multiplies them with Rᵀ and m.
//
// ROWS = 3: all rows at once (unrolled, 12 dot products). ROWS = 1: a row a clock (pipelined, 4). ROWS = 0: one dot
// product a clock (serial).
module body_mass #(
    parameter int ROWS = 1,
    parameter bit DEEP = 1'b0
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
    output logic [31:0] cycles
);
  localparam int LD = (DEEP ? 5 : 3) + 2 * (DEEP ? 6 : 5);  // of a dot product
  typedef enum logic [1:0] {LOAD, RUN, OUT} state_t;
  state_t st;
  logic [31:0] w [0:18];
  logic [31:0] x [0:8];
  logic [4:0] at;
  logic [7:0] t;
  logic       done;
  assign s_tready = (st == LOAD);
  assign m_tvalid = (st == OUT);
  assign m_tdata = x[at[3:0]];
  assign m_tlast = (at == 5'd8);
  assign err = 1'b0;
  always_ff @(posedge clk) begin
    if (!rst_n) begin
      st <= LOAD; at <= '0; t <= '0; cycles <= '0;
    end else begin
      if (st == RUN) cycles <= cycles + 1'b1;
      case (st)
        LOAD: if (s_tvalid) begin
          cycles <= '0; t <= '0;
          at <= (at == 5'd18) ? 5'd0 : at + 1'b1;
          if (at == 5'd18) st <= RUN;
        end
        RUN: begin
          t <= t + 1'b1;
          if (done) st <= OUT;
        end
        OUT: if (m_tready) begin
          at <= m_tlast ? 5'd0 : at + 1'b1;
          if (m_tlast) st <= LOAD;
        end
        default: st <= LOAD;
      endcase
    end
  end
  always_ff @(posedge clk) if (st == LOAD & s_tvalid) w[at] <= s_tdata;

  // Rows of R, columns of [J | s].
  wire [95:0] r [0:2];
  wire [95:0] c [0:3];
  assign r[0] = {w[2], w[1], w[0]};
  assign r[1] = {w[5], w[4], w[3]};
  assign r[2] = {w[8], w[7], w[6]};
  assign c[0] = {w[13], w[12], w[9]};
  assign c[1] = {w[14], w[10], w[12]};
  assign c[2] = {w[11], w[14], w[13]};
  assign c[3] = {w[17], w[16], w[15]};

  function automatic [3:0] place(input [1:0] i, input [1:0] j);  // of a result; 15: below the diagonal
    case ({i, j})
      4'b0000: place = 4'd0;
      4'b0001: place = 4'd1;
      4'b0010: place = 4'd2;
      4'b0101: place = 4'd3;
      4'b0110: place = 4'd4;
      4'b1010: place = 4'd5;
      4'b0011: place = 4'd6;
      4'b0111: place = 4'd7;
      4'b1011: place = 4'd8;
      default: place = 4'd15;
    endcase
  endfunction

  generate
    if (ROWS == 0) begin : serial
      // Dot product n of a phase is row n / 4, column n mod 4.
      localparam int SECOND = 12 + LD + 1;  // when the first phase is there
      logic [31:0] p [0:11];
      logic [95:0] a, b;
      wire  [31:0] y;
      dot3 #(.DEEP(DEEP)) u (.clk, .a, .b, .y);
      wire       second = (t >= 8'(SECOND));
      wire [3:0] n = second ? 4'(t - 8'(SECOND)) : t[3:0];
      always_ff @(posedge clk) begin
        a <= second ? ((&n[1:0]) ? {64'd0, p[{n[3:2], 2'd3}]} : {p[{n[3:2], 2'd2}], p[{n[3:2], 2'd1}], p[{n[3:2], 2'd0}]})
                    : r[n[3:2]];
        b <= second ? ((&n[1:0]) ? {64'd0, w[18]} : r[n[1:0]]) : c[n[1:0]];
      end
      wire [7:0] ta = t - 8'(LD + 1), tb = t - 8'(SECOND + LD + 1);
      always_ff @(posedge clk)
        if (st == RUN) begin
          if (ta < 8'd12) p[ta[3:0]] <= y;
          if (tb < 8'd12 && place(tb[3:2], tb[1:0]) != 4'd15) x[place(tb[3:2], tb[1:0])] <= y;
        end
      assign done = (t == 8'(SECOND + LD + 12));
    end else begin : rows
      // The rows of the first phase go from the dot products straight back into them.
      localparam int STEPS = (ROWS == 3) ? 1 : 3;
      // What a clock does is known at the one before.
      logic       second, leaves;
      logic [1:0] row_out;
      always_ff @(posedge clk) begin
        second <= (st == RUN) & (t >= 8'(LD));
        leaves <= (st == RUN) & (t >= 8'(2 * LD + 1)) & (t < 8'(2 * LD + 1 + STEPS));
        row_out <= 2'(t - 8'(2 * LD + 1));
      end
      genvar i, j;
      for (i = 0; i < ROWS; i = i + 1) begin : row
        wire [127:0] y;
        wire [1:0] now = (ROWS == 3) ? 2'(i) : t[1:0];
        wire [1:0] leaving = (ROWS == 3) ? 2'(i) : row_out;
        for (j = 0; j < 4; j = j + 1) begin : column
          logic [95:0] a, b;
          dot3 #(.DEEP(DEEP)) u (.clk, .a, .b, .y(y[32*j +: 32]));
          always_ff @(posedge clk) begin
            a <= ~second ? r[now] : (j == 3) ? {64'd0, y[127:96]} : y[95:0];
            b <= ~second ? c[j] : (j == 3) ? {64'd0, w[18]} : r[j % 3];
          end
          always_ff @(posedge clk)
            if (leaves && place(leaving, 2'(j)) != 4'd15) x[place(leaving, 2'(j))] <= y[32*j +: 32];
        end
      end
      assign done = (t == 8'(2 * LD + 1 + STEPS));
    end
  endgenerate
endmodule
