// Trust in the filter's matches: their support less their residual, and at least 0, by the age of
// their path.
//
// The support moves by 1/4 of its difference to 16 x margin, from 0 where the place does not follow
// from the one before by a step, and falls by 1/8 at least where the place stays the same. The
// residual is the most evidence against the matched place of this window and the two before, times
// 16. Margin and evidence saturate at RESIDUAL_TOP. The age is 0 where the place does not follow, and
// otherwise one more than before, up to 8: of so many eighths is the trust. Below TRUST a match is not
// trusted.
//
// `residual_i` is that of the place that has become the best (`became_i`). `update_i` begins when the
// match stands; `trust_o` and `trusted_o` are registered at the eleventh clock edge behind it, and
// the twelfth, and stay.
module vpr_trust #(
    localparam int         STEPS       = vpr_pkg::STEPS,
    localparam logic [8:0] TRUST       = vpr_pkg::TRUST,
    localparam int         PLACE_BITS  = vpr_pkg::PLACE_BITS,
    localparam int         METRIC_BITS = vpr_pkg::METRIC_BITS,
    localparam int         TRUST_BITS  = vpr_pkg::TRUST_BITS,
    localparam int         MARGIN_BITS = vpr_pkg::RESIDUAL_BITS,
    localparam int         MARGIN_LOW  = vpr_pkg::RESIDUAL_LOW,
    localparam logic [MARGIN_BITS-1:0] MARGIN_TOP = MARGIN_BITS'(vpr_pkg::RESIDUAL_TOP)
) (
    input  logic                   clk_i,
    input  logic                   rst_i,
    input  logic                   became_i,
    input  logic [MARGIN_BITS-1:0] residual_i,
    input  logic                   update_i,
    input  logic [PLACE_BITS-1:0]  best_i,
    input  logic [METRIC_BITS-1:0] best_sum_i,
    input  logic                   has_second_i,
    input  logic [METRIC_BITS-1:0] second_sum_i,
    output logic [TRUST_BITS-1:0]  trust_o,
    output logic                   trusted_o
);
    localparam int FRACTION       = TRUST_BITS - MARGIN_BITS;
    localparam int TRUST_SHIFT    = 2;
    localparam int STANDING_SHIFT = 3;
    localparam int AGE_BITS       = 4;
    localparam int WHOLE_AT       = AGE_BITS - 1;  // this bit says that the age is 8, and whole
    localparam int PHASES         = 6 + AGE_BITS;
    // steps to compare: wide enough for the longest as well
    localparam int BITS           = (PLACE_BITS > 5 ? PLACE_BITS : 5) + 1;
    localparam logic [4:0] LONGEST = 5'(STEPS - 1);

    logic [PHASES-1:0]             phase_q;
    logic                          placed_q, beyond_q, stays_q, falls_q;
    // as they are subtracted: the place of the match before, and the margin
    logic [BITS-1:0]               lowest_inverse_q;
    logic [METRIC_BITS-1:0]        margin_inverse_q;
    logic [MARGIN_BITS-1:0]        limited_inverse_q;
    logic [BITS-1:0]               step_q;  // from that place; from below it, very long
    logic [TRUST_BITS-1:0]         support_q;
    logic signed [TRUST_BITS:0]    difference_q;
    logic [TRUST_BITS-1:0]         moves_q;
    logic [AGE_BITS-1:0]           age_q;
    logic [TRUST_BITS-1:0]         whole_q;  // trust in a path of that age
    // their product, a bit of the age a clock: halves of eighths, as each bit halves what came before
    logic [AGE_BITS-1:0]           ages_q;
    logic [TRUST_BITS:0]           aged_q;
    // of this match, of the two before, the larger of these, and the largest of all
    logic [MARGIN_BITS-1:0]        newest_q, former_q, earlier_q, larger_q, worst_q;

    // what it falls by where the place stays, unless it falls by more than that anyway
    wire [TRUST_BITS-1:0]      fall  = support_q >> STANDING_SHIFT;
    wire signed [TRUST_BITS:0] moved = difference_q >>> TRUST_SHIFT;
    wire signed [TRUST_BITS:0] more  = moved + $signed({1'b0, fall});
    wire [TRUST_BITS:0]        lacking = {1'b0, trust_o} - (TRUST_BITS + 1)'(TRUST);
    wire [TRUST_BITS+1:0]      aged =
        {1'b0, aged_q} + {1'b0, whole_q & {TRUST_BITS{ages_q[0]}}, 1'b0};
    // the carry says that the support is not below the residual
    wire [MARGIN_BITS:0]       left =
        {1'b1, support_q[TRUST_BITS-1:FRACTION]} - {1'b0, worst_q};

    assign trust_o = aged_q[TRUST_BITS-1:0];

    always_ff @(posedge clk_i) begin
        phase_q      <= {phase_q[PHASES-2:0], update_i};
        margin_inverse_q <= best_sum_i + ~second_sum_i;
        if (!has_second_i) margin_inverse_q <= '0;
        limited_inverse_q <= &margin_inverse_q[METRIC_BITS-1:MARGIN_BITS]
            && |margin_inverse_q[MARGIN_BITS-1:MARGIN_LOW]
            ? margin_inverse_q[MARGIN_BITS-1:0] : ~MARGIN_TOP;
        step_q       <= BITS'(({BITS'(best_i), 1'b1} + {lowest_inverse_q, 1'b1}) >> 1);
        beyond_q     <= step_q[BITS-1:5] != 0 || step_q[4:0] > LONGEST;
        stays_q      <= placed_q && step_q == '0;
        difference_q <= ~({1'b1, limited_inverse_q, {FRACTION{1'b1}}} + {1'b0, support_q});
        falls_q      <= stays_q && !more[TRUST_BITS];
        moves_q      <= stays_q && !more[TRUST_BITS] ? ~fall : moved[TRUST_BITS-1:0];
        if (phase_q[1]) begin
            if (!placed_q || beyond_q) begin
                support_q <= '0;
                age_q     <= '0;
            end else if (!age_q[WHOLE_AT]) age_q <= age_q + 1'b1;
        end
        larger_q     <= former_q > earlier_q ? former_q : earlier_q;
        worst_q      <= newest_q > larger_q ? newest_q : larger_q;
        if (became_i) newest_q <= residual_i;
        if (phase_q[4]) begin
            // the inverse of the fall, and a carry
            support_q <= TRUST_BITS'(({support_q, 1'b1} + {moves_q, falls_q}) >> 1);
            lowest_inverse_q <= ~(BITS'(best_i));
            placed_q <= 1'b1;
        end
        if (phase_q[5]) begin
            whole_q   <= left[MARGIN_BITS]
                ? {left[MARGIN_BITS-1:0], support_q[FRACTION-1:0]} : '0;
            ages_q    <= age_q;
            aged_q    <= '0;
            former_q  <= newest_q;
            earlier_q <= former_q;
        end else if (|phase_q[PHASES-1:6]) begin
            ages_q <= ages_q >> 1;
            aged_q <= aged[TRUST_BITS+1:1];
        end
        trusted_o <= !lacking[TRUST_BITS];
        if (rst_i) begin
            phase_q   <= '0;
            placed_q  <= 1'b0;
            former_q  <= '0;
            earlier_q <= '0;
        end
    end

    wire unused = &{1'b0, moved[TRUST_BITS], more, lacking, aged[0]};
endmodule
