// Mean of the distances of a window, their mean absolute deviation from it, and the reciprocal of
// that: floor(2^16 / s), with s of at least 1. Means are rounded down.
//
// `clear` begins a window with a mean of 0, so that deviations are the distances at first. After
// the last of PLACES distances, `divide` ends a pass: their mean is kept for the next (`of_mean`),
// or it is the spread, whose reciprocal is then made. One register adds up, and divides by
// restoring, a bit a clock. `done` is high in the clock in which the results stand.
module vpr_spread #(
    parameter int PLACES          = 1,
    parameter int DISTANCE_BITS   = 1,
    parameter int TOTAL_BITS      = 1,
    parameter int RECIPROCAL_BITS = 17
) (
    input  logic                       clk,
    input  logic                       rst,
    input  logic                       clear,
    input  logic                       valid,
    input  logic [DISTANCE_BITS-1:0]   distance,
    input  logic                       of_mean,
    input  logic                       divide,
    output logic                       done,
    output logic [RECIPROCAL_BITS-1:0] reciprocal
);
    localparam int COUNT_BITS = $clog2(PLACES + 1);
    localparam int REST_BITS  = COUNT_BITS > DISTANCE_BITS ? COUNT_BITS : DISTANCE_BITS;
    localparam int LOW_BITS   = RECIPROCAL_BITS > DISTANCE_BITS ? RECIPROCAL_BITS : DISTANCE_BITS;
    localparam int STEP_BITS  = $clog2(LOW_BITS + 1);
    // The total is in the upper bits, where a quotient of DISTANCE_BITS bits needs it: what is
    // above the quotient's width is less than PLACES, and the rest of a division from the start
    localparam int UNUSED     = LOW_BITS - DISTANCE_BITS;

    localparam logic [1:0] ADDING  = 2'd0;
    localparam logic [1:0] MEAN    = 2'd1;  // divide by PLACES
    localparam logic [1:0] INVERSE = 2'd2;  // divide by the spread
    localparam logic [1:0] TAKE    = 2'd3;

    logic [1:0]               state;
    logic [STEP_BITS-1:0]     left;
    logic                     inverted;
    logic [REST_BITS-1:0]     rest;
    logic [LOW_BITS-1:0]      low;
    logic [DISTANCE_BITS-1:0] mean_inverse;  // as it is subtracted; in the end of the spread
    wire  [DISTANCE_BITS-1:0] mean = ~mean_inverse;
    logic [DISTANCE_BITS:0]   deviation;
    logic [DISTANCE_BITS-1:0] magnitude;
    logic                     deviates, adds, lacks;

    // the inverse of a negative deviation is its magnitude less one, which comes as a carry
    wire                     negative = deviation[DISTANCE_BITS];
    wire [TOTAL_BITS-1:0]    total    = TOTAL_BITS'({rest, low[LOW_BITS-1-:DISTANCE_BITS]});
    wire [TOTAL_BITS-1:0]    added    =
        TOTAL_BITS'(({total, 1'b1} + {TOTAL_BITS'(magnitude), lacks}) >> 1);

    wire [REST_BITS-1:0]     divisor  = state == MEAN ? REST_BITS'(PLACES) : REST_BITS'(mean);
    wire [REST_BITS:0]       trial    = {rest, low[LOW_BITS-1]};
    wire [REST_BITS+1:0]     lessened = {1'b0, trial} - {2'b00, divisor};
    wire                     fits     = !lessened[REST_BITS+1];
    wire [DISTANCE_BITS-1:0] quotient = low[DISTANCE_BITS-1:0];

    always_ff @(posedge clk) begin
        deviation <= {1'b0, distance} - {1'b0, mean};
        deviates  <= valid;
        magnitude <= deviation[DISTANCE_BITS-1:0] ^ {DISTANCE_BITS{negative}};
        lacks     <= negative;
        adds      <= deviates;
        done      <= 1'b0;
        case (state)
            ADDING: begin
                inverted <= 1'b0;
                left     <= STEP_BITS'(DISTANCE_BITS - 1);
                if (adds) begin
                    rest <= REST_BITS'(added >> DISTANCE_BITS);
                    low  <= LOW_BITS'(added[DISTANCE_BITS-1:0]) << UNUSED;
                end
                if (divide) state <= MEAN;
            end
            TAKE: begin
                rest  <= '0;
                low   <= '0;
                left  <= STEP_BITS'(RECIPROCAL_BITS - 1);
                state <= inverted || of_mean ? ADDING : INVERSE;
                done  <= inverted || of_mean;
                if (inverted) reciprocal <= low[RECIPROCAL_BITS-1:0];
                else begin
                    mean_inverse <= ~quotient;
                    if (!of_mean) begin
                        if (quotient == 0) mean_inverse[0] <= 1'b0;
                        low[LOW_BITS-1] <= 1'b1;
                        inverted        <= 1'b1;
                    end
                end
            end
            default: begin
                rest <= fits ? lessened[REST_BITS-1:0] : trial[REST_BITS-1:0];
                low  <= LOW_BITS'({low, fits});
                left <= left - 1'b1;
                if (left == 0) state <= TAKE;
            end
        endcase
        if (clear || rst) begin
            state    <= ADDING;
            deviates <= 1'b0;
            adds     <= 1'b0;
            mean_inverse <= '1;
            rest     <= '0;
            low      <= '0;
        end
        if (rst) begin
            reciprocal <= '0;
            done       <= 1'b0;
        end
    end
endmodule
