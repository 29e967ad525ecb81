// Trust in the filter's matches: their support less their misfit, and at least 0.
//
// The support moves by 1/4 of its difference to 16 x margin, from 0 where the place does not follow
// from the one before by a step, and falls by 1/16 at least where the place stays the same. The
// misfit is the most evidence against the matched place of this window and the two before, times
// 16. Margin and evidence saturate at 23. Below TRUST a match is not trusted.
//
// `misfit` is that of the place that has become the best (`became`). `update` begins when the match
// stands; `trust` and `trusted` are registered at the seventh clock edge behind it, and the eighth,
// and stay.
module vpr_trust #(
    localparam int         STEPS       = vpr_pkg::STEPS,
    localparam int         BACK        = vpr_pkg::BACK,
    localparam logic [8:0] TRUST       = vpr_pkg::TRUST,
    localparam int         PLACE_BITS  = vpr_pkg::PLACE_BITS,
    localparam int         METRIC_BITS = vpr_pkg::METRIC_BITS,
    localparam int         TRUST_BITS  = vpr_pkg::TRUST_BITS,
    localparam int         MARGIN_BITS = vpr_pkg::MISFIT_BITS
) (
    input  logic                   clk,
    input  logic                   rst,
    input  logic                   became,
    input  logic [MARGIN_BITS-1:0] misfit,
    input  logic                   update,
    input  logic [PLACE_BITS-1:0]  best,
    input  logic [METRIC_BITS-1:0] best_sum,
    input  logic                   has_second,
    input  logic [METRIC_BITS-1:0] second_sum,
    output logic [TRUST_BITS-1:0]  trust,
    output logic                   trusted
);
    localparam int FRACTION       = TRUST_BITS - MARGIN_BITS;
    localparam int TRUST_SHIFT    = 2;
    localparam int STANDING_SHIFT = 4;
    // a place follows by 2 at least, whatever the steps
    localparam int LAST           = (STEPS > 3 ? STEPS : 3) - 1;
    // steps to compare: wide enough for the longest as well
    localparam int BITS           = (PLACE_BITS > 5 ? PLACE_BITS : 5) + 1;
    localparam logic [4:0] LONGEST = 5'(LAST + BACK);
    localparam logic [MARGIN_BITS-1:0] MARGIN_TOP = MARGIN_BITS'(23);

    logic [5:0]                    phase;
    logic                          placed, beyond, stays, falls;
    // as they are subtracted: the lowest place that follows from the match before, and the margin
    logic [BITS-1:0]               lowest_inverse;
    logic [METRIC_BITS-1:0]        margin_inverse;
    logic [MARGIN_BITS-1:0]        limited_inverse;
    logic [BITS-1:0]               step;  // from that place; from below it, very long
    logic [TRUST_BITS-1:0]         support;
    logic signed [TRUST_BITS:0]    difference;
    logic [TRUST_BITS-1:0]         moves;
    // of this match, of the two before, the larger of these, and the largest of all
    logic [MARGIN_BITS-1:0]        newest, former, earlier, larger, worst;

    // what it falls by where the place stays, unless it falls by more than that anyway
    wire [TRUST_BITS-1:0]      fall  = support >> STANDING_SHIFT;
    wire signed [TRUST_BITS:0] moved = difference >>> TRUST_SHIFT;
    wire signed [TRUST_BITS:0] more  = moved + $signed({1'b0, fall});
    wire [TRUST_BITS:0]        lacking = {1'b0, trust} - (TRUST_BITS + 1)'(TRUST);
    // the carry says that the support is not below the misfit
    wire [MARGIN_BITS:0]       left =
        {1'b1, support[TRUST_BITS-1:FRACTION]} - {1'b0, worst};

    always_ff @(posedge clk) begin
        phase      <= {phase[4:0], update};
        margin_inverse <= best_sum + ~second_sum;
        if (!has_second) margin_inverse <= '0;
        // 24 and above are those with both upper bits, or with more
        limited_inverse <= &margin_inverse[METRIC_BITS-1:MARGIN_BITS]
            && |margin_inverse[MARGIN_BITS-1:MARGIN_BITS-2]
            ? margin_inverse[MARGIN_BITS-1:0] : ~MARGIN_TOP;
        step       <= BITS'(({BITS'(best), 1'b1} + {lowest_inverse, 1'b1}) >> 1);
        beyond     <= step[BITS-1:5] != 0 || step[4:0] > LONGEST;
        stays      <= placed && step == BITS'(BACK);
        difference <= ~({1'b1, limited_inverse, {FRACTION{1'b1}}} + {1'b0, support});
        falls      <= stays && !more[TRUST_BITS];
        moves      <= stays && !more[TRUST_BITS] ? ~fall : moved[TRUST_BITS-1:0];
        if (phase[1] && (!placed || beyond)) support <= '0;
        larger     <= former > earlier ? former : earlier;
        worst      <= newest > larger ? newest : larger;
        if (became) newest <= misfit;
        if (phase[4]) begin
            // the inverse of the fall, and a carry
            support <= TRUST_BITS'(({support, 1'b1} + {moves, falls}) >> 1);
            lowest_inverse <= ~(BITS'(best) - BITS'(BACK));
            placed <= 1'b1;
        end
        if (phase[5]) begin
            trust   <= left[MARGIN_BITS]
                ? {left[MARGIN_BITS-1:0], support[FRACTION-1:0]} : '0;
            former  <= newest;
            earlier <= former;
        end
        trusted <= !lacking[TRUST_BITS];
        if (rst) begin
            phase   <= '0;
            placed  <= 1'b0;
            former  <= '0;
            earlier <= '0;
        end
    end

    wire unused = &{1'b0, moved[TRUST_BITS], more, lacking};
endmodule
