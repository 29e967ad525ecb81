// Usual number of events in a window, in units of 1/256 event, and the activity of the window that
// ended: floor(16 log2(1 + its events)) less that of the usual number, in whole events, before it
// (LOGARITHMS), and -368, the least that there is, of a window without events. The open window
// pauses (`pauses_o`) if it has no events, or less than 1/16 of the usual number.
//
// With `window_end_i` the usual number moves by 1/64 of its difference to the window's; the events of
// a window saturate. That is done a bit a clock, while `settled_o` is low: until then no event may be
// counted, and no window may end. Both numbers come round before, five times each, for their
// logarithms. `activity_inverse_o` stands from `settled_o` on.
module vpr_activity #(
    localparam int EVENTS_BITS   = vpr_pkg::WINDOW_EVENTS_BITS,
    localparam int ACTIVITY_BITS = vpr_pkg::ACTIVITY_BITS,
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
    localparam int PAUSE_SHIFT    = 4;
    localparam int ACTIVITY_SHIFT = 6;
    localparam int DROPPED        = FRACTION + PAUSE_SHIFT;
    localparam int UPPER_BITS     = ACTIVITY_BITS - DROPPED;
    // a round: a step for each bit of the usual number, and one behind them
    localparam int LAST           = ACTIVITY_BITS;
    localparam int STEP_BITS      = $clog2(LAST + 1);
    // an event is 256, and moves the usual number by 1/64 of that, which is not its lowest bit
    localparam int EVENT_AT       = FRACTION - ACTIVITY_SHIFT;

    logic [EVENTS_BITS-1:0]   events_q;
    logic [ACTIVITY_BITS-1:0] usual_q;

    // The window does not pause if events << DROPPED >= usual: from the event on with which it has as
    // many as the upper bits of the usual number say, or one more, if the lower are not all 0.
    // Higher bits of the events are 0 until then.
    logic partly_q, any_q, more_q;
    // of the clock before: no window ends within two clocks of an event
    logic as_many_q, was_counted_q;

    assign pauses_o = !any_q || !(more_q || (as_many_q && !partly_q));

    // Rounds: five of the usual number, and five of the events, in the last of which it moves. Then
    // the logarithm of the events is complete within three steps (`finishing_q`).
    logic [STEP_BITS-1:0] step_q;
    logic [4:0]           round_q;
    logic                 of_events_q, finishing_q;
    // which bits are at hand; registers, as comparing the step takes its time
    logic turns_q, has_events_q, has_upper_q, below_event_q, came_below_q, logged_q;

    wire begins = step_q == STEP_BITS'(1);
    wire ends   = step_q == STEP_BITS'(LAST);
    wire moves  = of_events_q && round_q[0];

    // usual + events * 2^EVENT_AT - usual / 64, rounded up, from the lowest bit on: the bit of the
    // quotient is still in the register, until new ones come (`has_upper_q`). The events are shifted
    // out (`has_events_q`), which leaves none for the next window. If they have wrapped (`full_q`), all
    // their bits are taken as 1.
    logic borrow_q, carry_q, wrapped_q, full_q;

    wire upper      = has_upper_q && usual_q[ACTIVITY_SHIFT];
    wire difference = usual_q[0] ^ upper ^ borrow_q;
    wire of_window  = has_events_q && (events_q[0] || full_q);
    wire next       = of_window ^ difference ^ carry_q;

    // not taken while events are shifted: with the operand that is not 0 then, an FPGA has sum and
    // selection of a bit in one cell
    wire [EVENTS_BITS:0] one_more =
        {wrapped_q, events_q} + {1'b0, {EVENTS_BITS{has_events_q}}} + (EVENTS_BITS + 1)'(counted_i);

    always_ff @(posedge clk_i) begin
        if (load_i) {wrapped_q, events_q} <= '0;
        else {wrapped_q, events_q} <= has_events_q
            ? {1'b0, events_q[0] && !moves, events_q[EVENTS_BITS-1:1]} : one_more;
        if (load_i || finishing_q) full_q <= 1'b0;
        else if (wrapped_q) full_q <= 1'b1;
        if (window_end_i || load_i) begin
            any_q  <= 1'b0;
            more_q <= 1'b0;
        end else if (counted_i) any_q <= 1'b1;
        as_many_q     <= events_q[UPPER_BITS-1:0] == usual_q[ACTIVITY_BITS-1:DROPPED];
        was_counted_q <= counted_i && !window_end_i && !load_i;
        if (as_many_q && was_counted_q) more_q <= 1'b1;
        if (!turns_q) begin
            borrow_q      <= usual_q[ACTIVITY_SHIFT-1:0] != 0;
            carry_q       <= 1'b0;
            has_upper_q   <= 1'b1;
            below_event_q <= 1'b1;
            came_below_q  <= 1'b0;
        end else begin
            borrow_q <= (!usual_q[0] && (upper || borrow_q)) || (upper && borrow_q);
            carry_q  <= (of_window && (difference || carry_q)) || (difference && carry_q);
            usual_q  <= {moves ? next : usual_q[0], usual_q[ACTIVITY_BITS-1:1]};
            // the bit that came with the clock before
            came_below_q <= below_event_q;
            if (moves && came_below_q && usual_q[ACTIVITY_BITS-1]) partly_q <= 1'b1;
            if (step_q == STEP_BITS'(ACTIVITY_BITS - ACTIVITY_SHIFT - 1)) has_upper_q <= 1'b0;
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
            step_q <= ends ? '0 : step_q + 1'b1;
            if (step_q == STEP_BITS'(ACTIVITY_BITS - 1)) turns_q <= 1'b0;
            if (begins && turns_q) has_events_q <= 1'b1;
            if (step_q == STEP_BITS'(EVENT_AT + EVENTS_BITS - 1)) has_events_q <= 1'b0;
            if (of_events_q ? begins && turns_q : step_q == STEP_BITS'(FRACTION - 1)) logged_q <= 1'b1;
            if (ends) begin
                logged_q <= 1'b0;
                round_q  <= {round_q[0], round_q[4:1]};
                if (round_q[0]) of_events_q <= 1'b1;
                if (moves) finishing_q <= 1'b1;
                else turns_q <= 1'b1;
            end
            if (finishing_q && step_q == STEP_BITS'(2)) begin
                settled_o   <= 1'b1;
                finishing_q <= 1'b0;
            end
        end
        if (load_i) begin
            usual_q      <= start_activity_i;
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
            logic       silent_q;
            logic [8:0] inverse, of_usual_q;

            vpr_logarithm logarithm (
                .clk_i(clk_i), .round_i(round_q), .valid_i(logged_q),
                .number_i(of_events_q ? of_window : turns_q && usual_q[0]), .decide_i(begins),
                .inverse_o(inverse)
            );

            // complete behind `begins`, and changed by the first bit of the next number
            always_ff @(posedge clk_i) begin
                if (window_end_i) silent_q <= !any_q;
                if (step_q == STEP_BITS'(2)) begin
                    // that of most events, if there was none, whose logarithm is 0
                    if (round_q[4]) of_usual_q <= silent_q ? 9'd368 : ~inverse;
                    if (finishing_q) activity_inverse_o <= {1'b0, of_usual_q} + {1'b1, inverse};
                end
            end
        end else begin : g_none
            assign activity_inverse_o = '1;
            wire unused = &{1'b0, logged_q, begins};
        end
    endgenerate
endmodule
