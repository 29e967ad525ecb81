// Trust in the filter's matches: it moves by 1/4 of its difference to 16 x margin, from 0 where the
// place does not follow from the one before by a step, and falls by 1/16 at least where the place
// stays the same. Below TRUST a match is not trusted.
//
// `update` begins when the match stands; `trust` and `trusted` are registered at the sixth clock
// edge behind it, and the seventh, and stay.
module vpr_trust #(
    parameter int           STEPS       = 1,
    parameter int           BACK        = 0,
    parameter logic [13:0]  TRUST       = 0,
    parameter int           PLACE_BITS  = 1,
    parameter int           METRIC_BITS = 10,
    parameter int           TRUST_BITS  = 14
) (
    input  logic                   clk,
    input  logic                   rst,
    input  logic                   update,
    input  logic [PLACE_BITS-1:0]  best,
    input  logic [METRIC_BITS-1:0] best_sum,
    input  logic                   has_second,
    input  logic [METRIC_BITS-1:0] second_sum,
    output logic [TRUST_BITS-1:0]  trust,
    output logic                   trusted
);
    localparam int FRACTION       = TRUST_BITS - METRIC_BITS;
    localparam int TRUST_SHIFT    = 2;
    localparam int STANDING_SHIFT = 4;
    localparam int QUIET_STEPS    = 3;
    localparam int LAST           = (STEPS > QUIET_STEPS ? STEPS : QUIET_STEPS) - 1;
    // steps to compare: wide enough for the longest as well
    localparam int BITS           = (PLACE_BITS > 5 ? PLACE_BITS : 5) + 1;
    localparam logic [4:0] LONGEST = 5'(LAST + BACK);

    logic [4:0]                    phase;
    logic                          placed, beyond, stays, falls;
    // as they are subtracted: the lowest place that follows from the match before, and the margin
    logic [BITS-1:0]               lowest_inverse;
    logic [METRIC_BITS-1:0]        margin_inverse;
    logic [BITS-1:0]               step;  // from that place; from below it, very long
    logic signed [TRUST_BITS:0]    difference;
    logic [TRUST_BITS-1:0]         moves;

    // what it falls by where the place stays, unless it falls by more than that anyway
    wire [TRUST_BITS-1:0]      fall  = trust >> STANDING_SHIFT;
    wire signed [TRUST_BITS:0] moved = difference >>> TRUST_SHIFT;
    wire signed [TRUST_BITS:0] more  = moved + $signed({1'b0, fall});
    wire [TRUST_BITS:0]        lacking = {1'b0, trust} - (TRUST_BITS + 1)'(TRUST);

    always_ff @(posedge clk) begin
        phase      <= {phase[3:0], update};
        margin_inverse <= best_sum + ~second_sum;
        if (!has_second) margin_inverse <= '0;
        step       <= BITS'(({BITS'(best), 1'b1} + {lowest_inverse, 1'b1}) >> 1);
        beyond     <= step[BITS-1:5] != 0 || step[4:0] > LONGEST;
        stays      <= placed && step == BITS'(BACK);
        difference <= ~({1'b1, margin_inverse, {FRACTION{1'b1}}} + {1'b0, trust});
        falls      <= stays && !more[TRUST_BITS];
        moves      <= stays && !more[TRUST_BITS] ? ~fall : moved[TRUST_BITS-1:0];
        if (phase[1] && (!placed || beyond)) trust <= '0;
        if (phase[4]) begin
            // the inverse of the fall, and a carry
            trust  <= TRUST_BITS'(({trust, 1'b1} + {moves, falls}) >> 1);
            lowest_inverse <= ~(BITS'(best) - BITS'(BACK));
            placed <= 1'b1;
        end
        trusted <= !lacking[TRUST_BITS];
        if (rst) begin
            phase  <= '0;
            placed <= 1'b0;
        end
    end

    wire unused = &{1'b0, moved[TRUST_BITS], more, lacking};
endmodule
