// Mean of the distances of a window, their mean absolute deviation from it, and the reciprocal of
// that: floor(2^16 / s), with s of at least 1. Means are rounded down. A multiplier of 16 bits is
// enough for it: half of a reciprocal of 2^16 is given, and that it is (`whole_o`).
//
// `clear_i` begins a window with a mean of 0, so that deviations are the distances at first. After
// the last of PLACES distances, `divide_i` ends a pass: their mean is kept for the next (`of_mean_i`),
// or it is the spread, whose reciprocal is then made. Division is by restoring, a bit a clock.
// `done_o` is high in the clock in which the results stand.
module vpr_spread #(
    localparam int PLACES          = vpr_pkg::PLACES,
    localparam int DISTANCE_BITS   = vpr_pkg::BIASED_BITS,
    localparam int TOTAL_BITS      = vpr_pkg::DISTANCE_TOTAL_BITS,
    localparam int RECIPROCAL_BITS = vpr_pkg::RECIPROCAL_BITS
) (
    input  logic                       clk_i,
    input  logic                       rst_i,
    input  logic                       clear_i,
    input  logic                       valid_i,
    input  logic [DISTANCE_BITS-1:0]   distance_i,
    input  logic                       of_mean_i,
    input  logic                       divide_i,
    output logic                       done_o,
    output logic                       has_spread_o,   // since reset there was a spread
    output logic                       whole_o,        // the reciprocal is 2^16, of a spread of 1
    output logic [RECIPROCAL_BITS-2:0] factor_o        // the reciprocal, or half of 2^16
);
    localparam int COUNT_BITS = $clog2(PLACES + 1);
    localparam int REST_BITS  = COUNT_BITS > DISTANCE_BITS ? COUNT_BITS : DISTANCE_BITS;
    localparam int LOW_BITS   = RECIPROCAL_BITS > TOTAL_BITS ? RECIPROCAL_BITS : TOTAL_BITS;
    localparam int STEP_BITS  = $clog2(LOW_BITS + 1);

    localparam logic [1:0] ADDING  = 2'd0;
    localparam logic [1:0] MEAN    = 2'd1;  // divide by PLACES
    localparam logic [1:0] INVERSE = 2'd2;  // divide by the spread
    localparam logic [1:0] TAKE    = 2'd3;

    logic [1:0]               state_q;
    logic [STEP_BITS-1:0]     left_q;
    logic                     inverted_q;
    logic [TOTAL_BITS-1:0]    total_q;
    // of a division: what is left of the dividend, its bits to come, and behind them the quotient's
    logic [REST_BITS-1:0]     rest_q;
    logic [LOW_BITS-1:0]      low_q;
    // of the mean, as it is subtracted; of what divides meanwhile: PLACES, and in the end the spread
    logic [REST_BITS-1:0]     mean_inverse_q;
    logic [DISTANCE_BITS:0]   deviation_q;
    logic [DISTANCE_BITS-1:0] magnitude_q;
    logic                     deviates_q, adds_q, lacks_q;
    logic                     divides_q;  // the total of the pass is there

    // the inverse of a negative deviation is its magnitude less one, which comes as a carry
    wire                     negative = deviation_q[DISTANCE_BITS];

    wire [REST_BITS:0]       trial    = {rest_q, low_q[LOW_BITS-1]};
    // the carry says that the divisor fits
    wire [REST_BITS+2:0]     lessened =
        {1'b0, trial, 1'b1} + {1'b0, 1'b1, mean_inverse_q, 1'b1};
    wire                     fits     = lessened[REST_BITS+2];
    wire [DISTANCE_BITS-1:0] quotient = low_q[DISTANCE_BITS-1:0];

    always_ff @(posedge clk_i) begin
        deviation_q <= {1'b0, distance_i} - {1'b0, ~mean_inverse_q[DISTANCE_BITS-1:0]};
        deviates_q  <= valid_i;
        magnitude_q <= deviation_q[DISTANCE_BITS-1:0] ^ {DISTANCE_BITS{negative}};
        lacks_q     <= negative;
        adds_q      <= deviates_q;
        done_o      <= 1'b0;
        divides_q   <= divide_i;
        if (adds_q)
            total_q <= TOTAL_BITS'(({total_q, 1'b1} + {TOTAL_BITS'(magnitude_q), lacks_q}) >> 1);
        case (state_q)
            ADDING: begin
                inverted_q <= 1'b0;
                left_q     <= STEP_BITS'(TOTAL_BITS - 1);
                rest_q     <= '0;
                low_q      <= LOW_BITS'(total_q) << (LOW_BITS - TOTAL_BITS);
                if (divides_q) begin
                    state_q        <= MEAN;
                    mean_inverse_q <= ~(REST_BITS'(PLACES));
                end
            end
            TAKE: begin
                rest_q  <= '0;
                low_q   <= '0;
                total_q <= '0;
                left_q  <= STEP_BITS'(RECIPROCAL_BITS - 1);
                state_q <= inverted_q || of_mean_i ? ADDING : INVERSE;
                done_o  <= inverted_q || of_mean_i;
                if (inverted_q) begin
                    has_spread_o <= 1'b1;
                    whole_o      <= low_q[RECIPROCAL_BITS-1];
                    factor_o     <= {low_q[RECIPROCAL_BITS-1] || low_q[RECIPROCAL_BITS-2],
                               low_q[RECIPROCAL_BITS-3:0]};
                end else begin
                    mean_inverse_q <= ~(REST_BITS'(quotient));
                    if (!of_mean_i) begin
                        if (quotient == 0) mean_inverse_q[0] <= 1'b0;
                        low_q[LOW_BITS-1] <= 1'b1;
                        inverted_q        <= 1'b1;
                    end
                end
            end
            default: begin
                rest_q <= fits ? lessened[REST_BITS:1] : trial[REST_BITS-1:0];
                low_q  <= LOW_BITS'({low_q, fits});
                left_q <= left_q - 1'b1;
                if (left_q == 0) state_q <= TAKE;
            end
        endcase
        if (clear_i || rst_i) begin
            state_q        <= ADDING;
            deviates_q     <= 1'b0;
            adds_q         <= 1'b0;
            divides_q      <= 1'b0;
            mean_inverse_q <= '1;
            total_q        <= '0;
        end
        if (rst_i) begin
            has_spread_o <= 1'b0;
            done_o       <= 1'b0;
        end
    end

    wire unused = &{1'b0, lessened[REST_BITS+1], lessened[0]};
endmodule
