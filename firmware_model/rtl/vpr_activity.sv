// Usual number of events in a window, in units of 1/256 event, and the activity of the window that
// ended: floor(16 log2(1 + its events)) less that of the usual number, in whole events, before it
// (LOGARITHMS), and -368, the least that there is, of a window without events. The open window pauses (`pauses`) if it has no events, or less than 1/16 of the usual
// number.
//
// With `window_end` the usual number moves by 1/64 of its difference to the window's; the events of
// a window saturate. That is done a bit a clock, while `settled` is low: until then no event may be
// counted, and no window may end. Both numbers come round before, five times each, for their
// logarithms. `activity_inverse` stands from `settled` on.
module vpr_activity #(
    localparam int EVENTS_BITS   = vpr_pkg::WINDOW_EVENTS_BITS,
    localparam int ACTIVITY_BITS = vpr_pkg::ACTIVITY_BITS,
    localparam bit LOGARITHMS    = vpr_pkg::FILTER
) (
    input  logic                     clk,
    input  logic                     load,
    input  logic [ACTIVITY_BITS-1:0] start_activity,
    input  logic                     counted,
    input  logic                     window_end,
    output logic                     settled,
    output logic                     pauses,
    output logic [9:0]               activity_inverse
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

    logic [EVENTS_BITS-1:0]   events;
    logic [ACTIVITY_BITS-1:0] usual;

    // The window does not pause if events << DROPPED >= usual: from the event on with which it has as
    // many as the upper bits of the usual number say, or one more, if the lower are not all 0.
    // Higher bits of the events are 0 until then.
    logic partly, any, more;
    // of the clock before: no window ends within two clocks of an event
    logic as_many, was_counted;

    assign pauses = !any || !(more || (as_many && !partly));

    // Rounds: five of the usual number, and five of the events, in the last of which it moves. Then
    // the logarithm of the events is complete within three steps (`finishing`).
    logic [STEP_BITS-1:0] step;
    logic [4:0]           round;
    logic                 of_events, finishing;
    // which bits are at hand; registers, as comparing the step takes its time
    logic turns, has_events, has_upper, below_event, came_below, logged;

    wire begins = step == STEP_BITS'(1);
    wire ends   = step == STEP_BITS'(LAST);
    wire moves  = of_events && round[0];

    // usual + events * 2^EVENT_AT - usual / 64, rounded up, from the lowest bit on: the bit of the
    // quotient is still in the register, until new ones come (`has_upper`). The events are shifted
    // out (`has_events`), which leaves none for the next window. If they have wrapped (`full`), all
    // their bits are taken as 1.
    logic borrow, carry, wrapped, full;

    wire upper      = has_upper && usual[ACTIVITY_SHIFT];
    wire difference = usual[0] ^ upper ^ borrow;
    wire of_window  = has_events && (events[0] || full);
    wire next       = of_window ^ difference ^ carry;

    // not taken while events are shifted: with the operand that is not 0 then, an FPGA has sum and
    // selection of a bit in one cell
    wire [EVENTS_BITS:0] one_more =
        {wrapped, events} + {1'b0, {EVENTS_BITS{has_events}}} + (EVENTS_BITS + 1)'(counted);

    always_ff @(posedge clk) begin
        if (load) {wrapped, events} <= '0;
        else {wrapped, events} <= has_events
            ? {1'b0, events[0] && !moves, events[EVENTS_BITS-1:1]} : one_more;
        if (load || finishing) full <= 1'b0;
        else if (wrapped) full <= 1'b1;
        if (window_end || load) begin
            any  <= 1'b0;
            more <= 1'b0;
        end else if (counted) any <= 1'b1;
        as_many     <= events[UPPER_BITS-1:0] == usual[ACTIVITY_BITS-1:DROPPED];
        was_counted <= counted && !window_end && !load;
        if (as_many && was_counted) more <= 1'b1;
        if (!turns) begin
            borrow      <= usual[ACTIVITY_SHIFT-1:0] != 0;
            carry       <= 1'b0;
            has_upper   <= 1'b1;
            below_event <= 1'b1;
            came_below  <= 1'b0;
        end else begin
            borrow <= (!usual[0] && (upper || borrow)) || (upper && borrow);
            carry  <= (of_window && (difference || carry)) || (difference && carry);
            usual  <= {moves ? next : usual[0], usual[ACTIVITY_BITS-1:1]};
            // the bit that came with the clock before
            came_below <= below_event;
            if (moves && came_below && usual[ACTIVITY_BITS-1]) partly <= 1'b1;
            if (step == STEP_BITS'(ACTIVITY_BITS - ACTIVITY_SHIFT - 1)) has_upper <= 1'b0;
            if (step == STEP_BITS'(DROPPED - 1)) below_event <= 1'b0;
        end
        if (window_end) begin
            settled   <= 1'b0;
            partly    <= 1'b0;
            turns     <= 1'b1;
            step      <= '0;
            round     <= LOGARITHMS ? 5'b10000 : 5'b00001;
            of_events <= !LOGARITHMS;
        end else if (!settled) begin
            step <= ends ? '0 : step + 1'b1;
            if (step == STEP_BITS'(ACTIVITY_BITS - 1)) turns <= 1'b0;
            if (begins && turns) has_events <= 1'b1;
            if (step == STEP_BITS'(EVENT_AT + EVENTS_BITS - 1)) has_events <= 1'b0;
            if (of_events ? begins && turns : step == STEP_BITS'(FRACTION - 1)) logged <= 1'b1;
            if (ends) begin
                logged <= 1'b0;
                round  <= {round[0], round[4:1]};
                if (round[0]) of_events <= 1'b1;
                if (moves) finishing <= 1'b1;
                else turns <= 1'b1;
            end
            if (finishing && step == STEP_BITS'(2)) begin
                settled   <= 1'b1;
                finishing <= 1'b0;
            end
        end
        if (load) begin
            usual      <= start_activity;
            partly     <= start_activity[DROPPED-1:0] != 0;
            settled    <= 1'b1;
            turns      <= 1'b0;
            has_events <= 1'b0;
            logged     <= 1'b0;
            finishing  <= 1'b0;
        end
    end

    generate
        if (LOGARITHMS) begin : g_logarithms
            logic       silent;
            logic [8:0] inverse, of_usual;

            vpr_logarithm logarithm (
                .clk(clk), .round(round), .valid(logged),
                .number(of_events ? of_window : turns && usual[0]), .decide(begins),
                .inverse(inverse)
            );

            // complete behind `begins`, and changed by the first bit of the next number
            always_ff @(posedge clk) begin
                if (window_end) silent <= !any;
                if (step == STEP_BITS'(2)) begin
                    // that of most events, if there was none, whose logarithm is 0
                    if (round[4]) of_usual <= silent ? 9'd368 : ~inverse;
                    if (finishing) activity_inverse <= {1'b0, of_usual} + {1'b1, inverse};
                end
            end
        end else begin : g_none
            assign activity_inverse = '1;
            wire unused = &{1'b0, logged, begins};
        end
    endgenerate
endmodule
