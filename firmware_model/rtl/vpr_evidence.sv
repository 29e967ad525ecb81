// Evidence against a place: its distance less the least one, divided by the spread, saturated, and
// weighted in eighths. A pause has none.
//
// `against_o` follows `distance_i` four clocks later, and `residual_o` with it: the same, saturated at
// RESIDUAL_TOP.
module vpr_evidence #(
    localparam int DISTANCE_BITS   = vpr_pkg::BIASED_BITS,
    localparam int RECIPROCAL_BITS = vpr_pkg::RECIPROCAL_BITS,
    localparam int EVIDENCE_BITS   = vpr_pkg::EVIDENCE_BITS,
    localparam int RESIDUAL_BITS   = vpr_pkg::RESIDUAL_BITS,
    localparam int RESIDUAL_LOW    = vpr_pkg::RESIDUAL_LOW,
    localparam logic [RESIDUAL_BITS-1:0] RESIDUAL_TOP = RESIDUAL_BITS'(vpr_pkg::RESIDUAL_TOP)
) (
    input  logic                       clk_i,
    input  logic                       paused_i,
    input  logic [DISTANCE_BITS-1:0]   distance_i,
    input  logic [DISTANCE_BITS-1:0]   nearest_inverse_i,
    input  logic                       whole_i,  // see vpr_spread
    input  logic [RECIPROCAL_BITS-2:0] factor_i,
    input  logic [3:0]                 weight_i,
    output logic [EVIDENCE_BITS-1:0]   against_o,
    output logic [RESIDUAL_BITS-1:0]   residual_o
);
    localparam int PRODUCT_BITS = DISTANCE_BITS + RECIPROCAL_BITS - 1;
    // fraction bits of the reciprocal, less those of a metric
    localparam int SHIFT        = RECIPROCAL_BITS - 1 - 2;

    logic [DISTANCE_BITS-1:0] above_q;
    logic [PRODUCT_BITS-1:0]  product_q;
    logic [EVIDENCE_BITS-1:0] limited_q;
    logic [EVIDENCE_BITS+3:0] evidence_q;  // in eighths

    // half of a reciprocal of 2^16: a shift of one bit less
    wire [PRODUCT_BITS-SHIFT:0] divided =
        whole_i ? product_q[PRODUCT_BITS-1:SHIFT-1] : {1'b0, product_q[PRODUCT_BITS-1:SHIFT]};

    assign against_o  = evidence_q[EVIDENCE_BITS+2:3];
    assign residual_o =
        (against_o >> RESIDUAL_BITS) != 0 || &against_o[RESIDUAL_BITS-1:RESIDUAL_LOW]
        ? RESIDUAL_TOP : RESIDUAL_BITS'(against_o);

    always_ff @(posedge clk_i) begin
        // with a carry into the lowest bit
        above_q    <= DISTANCE_BITS'(({distance_i, 1'b1} + {nearest_inverse_i, 1'b1}) >> 1);
        product_q  <= PRODUCT_BITS'(above_q) * PRODUCT_BITS'(factor_i);
        limited_q  <= paused_i ? '0
                    : (divided >> EVIDENCE_BITS) != 0 ? '1 : EVIDENCE_BITS'(divided);
        evidence_q <= (EVIDENCE_BITS + 4)'(limited_q) * (EVIDENCE_BITS + 4)'(weight_i);
    end

    wire unused = &{1'b0, product_q[SHIFT-1:0], evidence_q};
endmodule
