// A register that stays one of its own, however many others hold the same: tools merge equal registers, except across
// the bounds of modules that are to be kept.
(* keep_hierarchy *)
module own_register #(
    parameter int W = 1
) (
    input  logic         clk,
    input  logic [W-1:0] d,
    output logic [W-1:0] q
);
  always_ff @(posedge clk) q <= d;
endmodule
