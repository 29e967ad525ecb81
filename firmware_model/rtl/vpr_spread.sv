// Mean of the distances of a window, their mean absolute deviation from it, and the reciprocal of
// that: floor(2^16 / s), with s of at least 1. Means are rounded down. A multiplier of 16 bits is
// enough for it: half of a reciprocal of 2^16 is given, and that it is (`whole`).
//
// `clear` begins a window with a mean of 0, so that deviations are the distances at first. After
// the last of PLACES distances, `divide` ends a pass: their mean is kept for the next (`of_mean`),
// or it is the spread, whose reciprocal is then made. Division is by restoring, a bit a clock.
// `done` is high in the clock in which the results stand.
module vpr_spread #(
    localparam int PLACES          = vpr_pkg::PLACES,
    localparam int DISTANCE_BITS   = vpr_pkg::DISTANCE_BITS,
    localparam int TOTAL_BITS      = vpr_pkg::DISTANCE_TOTAL_BITS,
    localparam int RECIPROCAL_BITS = vpr_pkg::RECIPROCAL_BITS
) (
    input  logic                       clk,
    input  logic                       rst,
    input  logic                       clear,
    input  logic                       valid,
    input  logic [DISTANCE_BITS-1:0]   distance,
    input  logic                       of_mean,
    input  logic                       divide,
    output logic                       done,
    output logic                       known,   // since reset there was a spread
    output logic                       whole,   // the reciprocal is 2^16, of a spread of 1
    output logic [RECIPROCAL_BITS-2:0] factor   // the reciprocal, or half of 2^16
);
    localparam int COUNT_BITS = $clog2(PLACES + 1);
    localparam int REST_BITS  = COUNT_BITS > DISTANCE_BITS ? COUNT_BITS : DISTANCE_BITS;
    localparam int LOW_BITS   = RECIPROCAL_BITS > TOTAL_BITS ? RECIPROCAL_BITS : TOTAL_BITS;
    localparam int STEP_BITS  = $clog2(LOW_BITS + 1);

    localparam logic [1:0] ADDING  = 2'd0;
    localparam logic [1:0] MEAN    = 2'd1;  // divide by PLACES
    localparam logic [1:0] INVERSE = 2'd2;  // divide by the spread
    localparam logic [1:0] TAKE    = 2'd3;

    logic [1:0]               state;
    logic [STEP_BITS-1:0]     left;
    logic                     inverted;
    logic [TOTAL_BITS-1:0]    total;
    // of a division: what is left of the dividend, its bits to come, and behind them the quotient's
    logic [REST_BITS-1:0]     rest;
    logic [LOW_BITS-1:0]      low;
    // of the mean, as it is subtracted; of what divides meanwhile: PLACES, and in the end the spread
    logic [REST_BITS-1:0]     mean_inverse;
    logic [DISTANCE_BITS:0]   deviation;
    logic [DISTANCE_BITS-1:0] magnitude;
    logic                     deviates, adds, lacks;
    logic                     divides;  // the total of the pass is there

    // the inverse of a negative deviation is its magnitude less one, which comes as a carry
    wire                     negative = deviation[DISTANCE_BITS];

    wire [REST_BITS:0]       trial    = {rest, low[LOW_BITS-1]};
    // the carry says that the divisor fits
    wire [REST_BITS+2:0]     lessened =
        {1'b0, trial, 1'b1} + {1'b0, 1'b1, mean_inverse, 1'b1};
    wire                     fits     = lessened[REST_BITS+2];
    wire [DISTANCE_BITS-1:0] quotient = low[DISTANCE_BITS-1:0];

    always_ff @(posedge clk) begin
        deviation <= {1'b0, distance} - {1'b0, ~mean_inverse[DISTANCE_BITS-1:0]};
        deviates  <= valid;
        magnitude <= deviation[DISTANCE_BITS-1:0] ^ {DISTANCE_BITS{negative}};
        lacks     <= negative;
        adds      <= deviates;
        done      <= 1'b0;
        divides   <= divide;
        if (adds)
            total <= TOTAL_BITS'(({total, 1'b1} + {TOTAL_BITS'(magnitude), lacks}) >> 1);
        case (state)
            ADDING: begin
                inverted <= 1'b0;
                left     <= STEP_BITS'(TOTAL_BITS - 1);
                rest     <= '0;
                low      <= LOW_BITS'(total) << (LOW_BITS - TOTAL_BITS);
                if (divides) begin
                    state        <= MEAN;
                    mean_inverse <= ~(REST_BITS'(PLACES));
                end
            end
            TAKE: begin
                rest  <= '0;
                low   <= '0;
                total <= '0;
                left  <= STEP_BITS'(RECIPROCAL_BITS - 1);
                state <= inverted || of_mean ? ADDING : INVERSE;
                done  <= inverted || of_mean;
                if (inverted) begin
                    known  <= 1'b1;
                    whole  <= low[RECIPROCAL_BITS-1];
                    factor <= {low[RECIPROCAL_BITS-1] || low[RECIPROCAL_BITS-2],
                               low[RECIPROCAL_BITS-3:0]};
                end else begin
                    mean_inverse <= ~(REST_BITS'(quotient));
                    if (!of_mean) begin
                        if (quotient == 0) mean_inverse[0] <= 1'b0;
                        low[LOW_BITS-1] <= 1'b1;
                        inverted        <= 1'b1;
                    end
                end
            end
            default: begin
                rest <= fits ? lessened[REST_BITS:1] : trial[REST_BITS-1:0];
                low  <= LOW_BITS'({low, fits});
                left <= left - 1'b1;
                if (left == 0) state <= TAKE;
            end
        endcase
        if (clear || rst) begin
            state        <= ADDING;
            deviates     <= 1'b0;
            adds         <= 1'b0;
            divides      <= 1'b0;
            mean_inverse <= '1;
            total        <= '0;
        end
        if (rst) begin
            known <= 1'b0;
            done  <= 1'b0;
        end
    end

    wire unused = &{1'b0, lessened[REST_BITS+1], lessened[0]};
endmodule
