// End of a window by time, on a clock that wraps: what is left of the window at time t is
// end - t modulo 2^TIMESTAMP_BITS, read as a signed number. The window has ended if it is 0 or less.
//
// `take` reads the time of an event, if there is one; from the next clock, `over` says whether the window has ended
// by it. A new window moves the end by TAU_US, and what the event is behind it, a bit a clock:
// meanwhile `settled` is low, `over` has no meaning, and no event may be taken.
module vpr_window_timer #(
    localparam int          TIMESTAMP_BITS = vpr_pkg::TIMESTAMP_BITS,
    localparam logic [63:0] TAU_US         = vpr_pkg::TAU_US
) (
    input  logic                      clk,
    input  logic                      load,
    input  logic [TIMESTAMP_BITS-1:0] start_time,
    input  logic                      next_window,
    input  logic                      take,
    input  logic [TIMESTAMP_BITS-1:0] timestamp,
    output logic                      settled,
    output logic                      over
);
    localparam int STEP_BITS = $clog2(TIMESTAMP_BITS);
    localparam logic [(1<<STEP_BITS)-1:0] LESS_TAU =
        (1 << STEP_BITS)'(TIMESTAMP_BITS'(-TAU_US));
    localparam logic [(1<<STEP_BITS)-1:0] NEXT_OF_TAU = LESS_TAU >> 1;

    localparam int LOW_BITS = TIMESTAMP_BITS / 2;
    localparam logic [TIMESTAMP_BITS-2:0] LOW = (TIMESTAMP_BITS - 1)'((1 << LOW_BITS) - 1);

    // The inverse of the end is kept, as an adder that subtracts takes it; and t - end, and whether
    // the bits of that below the highest are 0. The carry of its lower half into the upper one is
    // `due`, as carries through both take too long. It would go through to the highest bit if the
    // others of the upper half are all 1 (`passes`), and is added when the end has moved.
    logic [TIMESTAMP_BITS-1:0] end_inverse, behind;
    logic                      low_zero, due, passes;
    logic [STEP_BITS-1:0]      step;
    logic                      end_carry;
    logic [1:0]                behind_carry;

    logic added;  // the bit of -TAU_US for this step, which is selected in the one before

    // `behind` is not negative, or the lowest number, which is its own negative
    assign over = behind[TIMESTAMP_BITS-1] == (due && passes) || low_zero;

    wire [2:0] moved    = 3'(behind[0]) + 3'(added) + 3'(behind_carry);
    wire       next_bit = moved[0];

    // bits of the difference that are 1 but for carries
    wire [TIMESTAMP_BITS-2:0] ones =
        timestamp[TIMESTAMP_BITS-2:0] ^ end_inverse[TIMESTAMP_BITS-2:0];

    always_ff @(posedge clk) begin
        if (load) end_inverse <= ~start_time;
        else if (!settled)
            end_inverse <= {end_inverse[0] ^ added ^ end_carry, end_inverse[TIMESTAMP_BITS-1:1]};
        if (settled && take) begin
            {due, behind[LOW_BITS-1:0]} <= (LOW_BITS + 1)'(({1'b0, timestamp[LOW_BITS-1:0], 1'b1}
                + {1'b0, end_inverse[LOW_BITS-1:0], 1'b1}) >> 1);
            behind[TIMESTAMP_BITS-1:LOW_BITS] <=
                timestamp[TIMESTAMP_BITS-1:LOW_BITS] + end_inverse[TIMESTAMP_BITS-1:LOW_BITS];
            low_zero <= &ones;
            passes   <= &(ones | LOW);
        end else if (!settled) begin
            behind <= {next_bit, behind[TIMESTAMP_BITS-1:1]};
            if (step == STEP_BITS'(LOW_BITS - 1)) due <= 1'b0;
            // all bits but the last to come
            low_zero <= step == STEP_BITS'(TIMESTAMP_BITS - 1) ? low_zero
                        : (low_zero || step == 0) && !next_bit;
        end
        if (settled) begin
            step         <= '0;
            added        <= LESS_TAU[0];
            end_carry    <= 1'b0;
            behind_carry <= '0;
            settled      <= !next_window;
        end else begin
            step         <= step + 1'b1;
            added        <= NEXT_OF_TAU[step];
            end_carry    <= (end_inverse[0] && (added || end_carry)) || (added && end_carry);
            behind_carry <= moved[2:1] + 2'(due && step == STEP_BITS'(LOW_BITS - 1));
            settled      <= step == STEP_BITS'(TIMESTAMP_BITS - 1);
        end
        if (load) begin
            settled   <= 1'b0;
            step      <= '0;
            added     <= LESS_TAU[0];
            end_carry <= 1'b0;
        end
    end
endmodule
