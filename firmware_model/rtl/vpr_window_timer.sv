// End of a window by time, on a clock that wraps: what is left of the window at time t is
// end - t modulo 2^TIMESTAMP_BITS, read as a signed number. The window has ended if it is 0 or less.
//
// `take_i` reads the time of an event, if there is one; from the next clock, `over_o` says whether
// the window has ended by it. A new window moves the end by TAU_US, and what the event is behind it,
// a bit a clock: meanwhile `settled_o` is low, `over_o` has no meaning, and no event may be taken.
module vpr_window_timer #(
    localparam int          TIMESTAMP_BITS = vpr_pkg::TIMESTAMP_BITS,
    localparam logic [63:0] TAU_US         = vpr_pkg::TAU_US
) (
    input  logic                      clk_i,
    input  logic                      load_i,
    input  logic [TIMESTAMP_BITS-1:0] start_time_i,
    input  logic                      next_window_i,
    input  logic                      take_i,
    input  logic [TIMESTAMP_BITS-1:0] timestamp_i,
    output logic                      settled_o,
    output logic                      over_o
);
    localparam int STEP_BITS = $clog2(TIMESTAMP_BITS);
    localparam logic [(1<<STEP_BITS)-1:0] LESS_TAU =
        (1 << STEP_BITS)'(TIMESTAMP_BITS'(-TAU_US));
    localparam logic [(1<<STEP_BITS)-1:0] NEXT_OF_TAU = LESS_TAU >> 1;

    localparam int LOW_BITS = TIMESTAMP_BITS / 2;
    localparam logic [TIMESTAMP_BITS-2:0] LOW = (TIMESTAMP_BITS - 1)'((1 << LOW_BITS) - 1);

    // The inverse of the end is kept, as an adder that subtracts takes it; and t - end, and whether
    // the bits of that below the highest are 0. The carry of its lower half into the upper one is
    // `due_q`, as carries through both take too long. It would go through to the highest bit if the
    // others of the upper half are all 1 (`passes_q`), and is added when the end has moved.
    logic [TIMESTAMP_BITS-1:0] end_inverse_q, behind_q;
    logic                      low_ones_q, due_q, passes_q;
    logic [STEP_BITS-1:0]      step_q;
    logic                      end_carry_q;
    logic [1:0]                behind_carry_q;

    logic added_q;  // the bit of -TAU_US for this step, which is selected in the one before

    // `behind_q` is not negative, or the lowest number, which is its own negative
    assign over_o = behind_q[TIMESTAMP_BITS-1] == (due_q && passes_q)
        || (low_ones_q && passes_q);

    wire [2:0] moved    = 3'(behind_q[0]) + 3'(added_q) + 3'(behind_carry_q);
    wire       next_bit = moved[0];
    wire       turns    = step_q == STEP_BITS'(LOW_BITS - 1);  // from the lower half to the upper

    // bits of the difference that are 1 but for carries
    wire [TIMESTAMP_BITS-2:0] ones =
        timestamp_i[TIMESTAMP_BITS-2:0] ^ end_inverse_q[TIMESTAMP_BITS-2:0];

    always_ff @(posedge clk_i) begin
        if (load_i) end_inverse_q <= ~start_time_i;
        else if (!settled_o)
            end_inverse_q <= {end_inverse_q[0] ^ added_q ^ end_carry_q, end_inverse_q[TIMESTAMP_BITS-1:1]};
        if (settled_o && take_i) begin
            {due_q, behind_q[LOW_BITS-1:0]} <= (LOW_BITS + 1)'(({1'b0, timestamp_i[LOW_BITS-1:0], 1'b1}
                + {1'b0, end_inverse_q[LOW_BITS-1:0], 1'b1}) >> 1);
            behind_q[TIMESTAMP_BITS-1:LOW_BITS] <=
                timestamp_i[TIMESTAMP_BITS-1:LOW_BITS] + end_inverse_q[TIMESTAMP_BITS-1:LOW_BITS];
            low_ones_q <= &(ones | ~LOW);
            passes_q   <= &(ones | LOW);
        end else if (!settled_o) begin
            behind_q <= {next_bit, behind_q[TIMESTAMP_BITS-1:1]};
            if (turns) due_q <= 1'b0;
            // what has moved by TAU_US is not the lowest number
            low_ones_q <= 1'b0;
        end
        if (settled_o) begin
            step_q         <= '0;
            added_q        <= LESS_TAU[0];
            end_carry_q    <= 1'b0;
            behind_carry_q <= '0;
            settled_o      <= !next_window_i;
        end else begin
            step_q         <= step_q + 1'b1;
            added_q        <= NEXT_OF_TAU[step_q];
            end_carry_q    <= (end_inverse_q[0] && (added_q || end_carry_q)) || (added_q && end_carry_q);
            behind_carry_q <= moved[2:1] + 2'(due_q && turns);
            settled_o      <= step_q == STEP_BITS'(TIMESTAMP_BITS - 1);
        end
        if (load_i) begin
            settled_o   <= 1'b0;
            step_q      <= '0;
            added_q     <= LESS_TAU[0];
            end_carry_q <= 1'b0;
        end
    end
endmodule
