// Mean activity, the running mean number of events in a window in units of 1/256 event, and the
// activity of the window that ended: floor(16 log2(1 + its events)) less the same of the mean activity
// before it, in whole events (LOGARITHMS), or with several gains of what it was at the start; -368, the
// least value, for a window without events. The open window is a pause (`pauses_o`) if it has no events,
// or less than 1/8 of the mean activity.
//
// At `window_end_i` the mean activity moves by 1/64 of its difference to the events of the window,
// which saturate; in a pause it falls by 1/1024. This takes one clock per bit, while `settled_o` is
// low: no event may be counted and no window may end until then. Before that, both numbers rotate five
// times each for their logarithms.
// `activity_inverse_o` is valid from `settled_o` on.
module vpr_activity #(
    localparam int EVENTS_BITS   = vpr_pkg::WINDOW_EVENTS_BITS,
    localparam int ACTIVITY_BITS = vpr_pkg::ACTIVITY_BITS,
    localparam int GAINS         = vpr_pkg::GAINS,
    localparam bit LOGARITHMS    = vpr_pkg::FILTER
) (
    input  logic                     clk_i,
    input  logic                     load_i,
    input  logic [ACTIVITY_BITS-1:0] start_activity_i,
    input  logic                     counted_i,
    input  logic                     window_end_i,
    output logic                     settled_o,
    output logic                     pauses_o,
    output logic [9:0]               activity_inverse_o
);
    localparam int FRACTION       = ACTIVITY_BITS - EVENTS_BITS;
    localparam int PAUSE_SHIFT    = 3;
    localparam int ACTIVITY_SHIFT = 6;
    localparam int DECAY_SHIFT    = 10;
    localparam int DROPPED        = FRACTION + PAUSE_SHIFT;
    localparam int UPPER_BITS     = ACTIVITY_BITS - DROPPED;
    // a round: a step for each bit of the mean activity, and one more
    localparam int LAST           = ACTIVITY_BITS;
    localparam int STEP_BITS      = $clog2(LAST + 1);
    // an event counts 256, and moves the mean activity by 1/64 of that, which is not its lowest bit
    localparam int EVENT_AT       = FRACTION - ACTIVITY_SHIFT;

    logic [EVENTS_BITS-1:0]   events_q;
    logic [ACTIVITY_BITS-1:0] mean_q;

    // The window is no pause if events << DROPPED >= mean activity: from the event on whose number
    // equals the upper bits of the mean activity, or the next event if the lower bits are not all 0.
    // Higher bits of the events are 0 until then.
    logic partly_q, any_q, more_q;
    // in the previous clock: no window ends within two clocks of an event
    logic as_many_q, was_counted_q;

    assign pauses_o = !any_q || !(more_q || (as_many_q && !partly_q));

    // Rounds: five of the mean activity and five of the events, in the last of which the mean moves.
    // The logarithm of the events is then complete within three steps (`finishing_q`).
    logic [STEP_BITS-1:0] step_q;
    logic [4:0]           round_q;
    logic                 of_events_q, finishing_q;
    // which bits are available; in registers, since comparing the step would lengthen the path. So are the
    // steps 1 and 2, that of the events' highest bit, and the last
    logic turns_q, has_events_q, has_upper_q, below_event_q, came_below_q, logged_q;
    logic begins_q, begun_q, highest_q, ends_q;

    wire moves = of_events_q && round_q[0];

    // mean + events * 2^EVENT_AT - mean / 64, rounded up, from the lowest bit on: the bit of the
    // quotient is still in the register, until new ones come (`has_upper_q`). The events rotate
    // (`has_events_q`), and in the last round are shifted out, which leaves none for the next window. If
    // they have wrapped (`full_q`), all their bits are taken as 1. Behind a pause (`paused_q`) it is
    // mean - mean / 1024, rounded up.
    logic upper_q, borrow_q, carry_q, turned_q, high_q, full_q, paused_q;

    // the bit of the quotient for the next clock
    wire pauses    = settled_o ? pauses_o : paused_q;
    wire has_upper = !turns_q || (has_upper_q && step_q != (paused_q
        ? STEP_BITS'(ACTIVITY_BITS - DECAY_SHIFT - 1) : STEP_BITS'(ACTIVITY_BITS - ACTIVITY_SHIFT - 1)));
    wire upper     = has_upper && (pauses ? (turns_q ? mean_q[DECAY_SHIFT+1] : mean_q[DECAY_SHIFT])
                                          : (turns_q ? mean_q[ACTIVITY_SHIFT+1] : mean_q[ACTIVITY_SHIFT]));

    wire difference = mean_q[0] ^ upper_q ^ borrow_q;
    wire of_window  = has_events_q && (events_q[0] || full_q);
    wire added      = of_window && !paused_q;
    wire next       = added ^ difference ^ carry_q;

    // not taken while events are shifted: with the operand that is not 0 then, an FPGA has sum and
    // selection of a bit in one cell
    wire [EVENTS_BITS-1:0] one_more =
        events_q + {EVENTS_BITS{has_events_q}} + EVENTS_BITS'(counted_i);

    always_ff @(posedge clk_i) begin
        turned_q <= (has_events_q ? events_q[1] : events_q[0]) && !moves;
        if (load_i) events_q <= '0;
        else events_q <= has_events_q ? {turned_q, events_q[EVENTS_BITS-1:1]} : one_more;
        high_q <= settled_o && !load_i && events_q[EVENTS_BITS-1];
        if (load_i || finishing_q) full_q <= 1'b0;
        else if (high_q && !events_q[EVENTS_BITS-1]) full_q <= 1'b1;
        if (window_end_i || load_i) begin
            any_q  <= 1'b0;
            more_q <= 1'b0;
        end else if (counted_i) any_q <= 1'b1;
        as_many_q     <= events_q[UPPER_BITS-1:0] == mean_q[ACTIVITY_BITS-1:DROPPED];
        was_counted_q <= counted_i && !window_end_i && !load_i;
        if (as_many_q && was_counted_q) more_q <= 1'b1;
        paused_q    <= pauses;
        upper_q     <= upper;
        has_upper_q <= has_upper;
        begins_q  <= !settled_o && step_q == 0;
        begun_q   <= begins_q;
        highest_q <= step_q == STEP_BITS'(EVENT_AT + EVENTS_BITS - 2);
        ends_q    <= !settled_o && step_q == STEP_BITS'(LAST - 1);
        if (!turns_q) begin
            borrow_q      <= mean_q[ACTIVITY_SHIFT-1:0] != 0
                || (pauses && mean_q[DECAY_SHIFT-1:ACTIVITY_SHIFT] != 0);
            carry_q       <= 1'b0;
            below_event_q <= 1'b1;
            came_below_q  <= 1'b0;
        end else begin
            borrow_q <= (!mean_q[0] && (upper_q || borrow_q)) || (upper_q && borrow_q);
            carry_q  <= (added && (difference || carry_q)) || (difference && carry_q);
            mean_q  <= {moves ? next : mean_q[0], mean_q[ACTIVITY_BITS-1:1]};
            // the bit that came with the clock before
            came_below_q <= below_event_q;
            if (moves && came_below_q && mean_q[ACTIVITY_BITS-1]) partly_q <= 1'b1;
            if (step_q == STEP_BITS'(DROPPED - 1)) below_event_q <= 1'b0;
        end
        if (window_end_i) begin
            settled_o   <= 1'b0;
            partly_q    <= 1'b0;
            turns_q     <= 1'b1;
            step_q      <= '0;
            round_q     <= LOGARITHMS ? 5'b10000 : 5'b00001;
            of_events_q <= !LOGARITHMS;
        end else if (!settled_o) begin
            step_q <= ends_q ? '0 : step_q + 1'b1;
            if (step_q == STEP_BITS'(ACTIVITY_BITS - 1)) turns_q <= 1'b0;
            if (begins_q && turns_q) has_events_q <= 1'b1;
            if (highest_q) has_events_q <= 1'b0;
            if (of_events_q ? begins_q && turns_q : step_q == STEP_BITS'(FRACTION - 1)) logged_q <= 1'b1;
            if (ends_q) begin
                logged_q <= 1'b0;
                round_q  <= {round_q[0], round_q[4:1]};
                if (round_q[0]) of_events_q <= 1'b1;
                if (moves) finishing_q <= 1'b1;
                else turns_q <= 1'b1;
            end
            if (finishing_q && begun_q) begin
                settled_o   <= 1'b1;
                finishing_q <= 1'b0;
            end
        end
        if (load_i) begin
            mean_q      <= start_activity_i;
            partly_q     <= start_activity_i[DROPPED-1:0] != 0;
            settled_o    <= 1'b1;
            turns_q      <= 1'b0;
            has_events_q <= 1'b0;
            logged_q     <= 1'b0;
            finishing_q  <= 1'b0;
        end
    end

    generate
        if (LOGARITHMS) begin : g_logarithms
            logic       silent_q, of_mean;
            logic [8:0] inverse, of_mean_q;

            if (GAINS == 1) begin : g_running
                assign of_mean = mean_q[0];
            end else begin : g_first
                logic [ACTIVITY_BITS-1:0] first_q;
                assign of_mean = first_q[0];
                always_ff @(posedge clk_i)
                    if (load_i) first_q <= start_activity_i;
                    else if (turns_q) first_q <= {first_q[0], first_q[ACTIVITY_BITS-1:1]};
            end

            vpr_logarithm logarithm (
                .clk_i(clk_i), .round_i(round_q), .valid_i(logged_q),
                .number_i(of_events_q ? of_window : turns_q && of_mean), .decide_i(begins_q),
                .inverse_o(inverse)
            );

            // complete behind `begins_q`, and changed by the first bit of the next number
            always_ff @(posedge clk_i) begin
                if (window_end_i) silent_q <= !any_q;
                if (begun_q) begin
                    // that of most events, if there was none, whose logarithm is 0
                    if (round_q[4]) of_mean_q <= silent_q ? 9'd368 : ~inverse;
                    if (finishing_q) activity_inverse_o <= {1'b0, of_mean_q} + {1'b1, inverse};
                end
            end
        end else begin : g_none
            assign activity_inverse_o = '1;
            wire unused = &{1'b0, logged_q, begins_q};
        end
    endgenerate
endmodule
