// Usual number of events in a window, in units of 1/256 event, and whether the open one is quiet: it
// has none, or less than 1/8 of that number. It pauses with none, or less than 1/16.
//
// With `window_end` the usual number moves by 1/64 of its difference to the window's; the events of
// a window saturate. That is done a bit a clock, while `settled` is low: until then no event may be
// counted, and no window may end. `quiet` and `pauses` are of the open window.
module vpr_activity #(
    parameter int EVENTS_BITS   = 23,
    parameter int ACTIVITY_BITS = 31
) (
    input  logic                     clk,
    input  logic                     load,
    input  logic [ACTIVITY_BITS-1:0] start_activity,
    input  logic                     counted,
    input  logic                     window_end,
    output logic                     settled,
    output logic                     quiet,
    output logic                     pauses
);
    localparam int FRACTION       = ACTIVITY_BITS - EVENTS_BITS;
    localparam int QUIET_SHIFT    = 3;  // a pause: one more
    localparam int ACTIVITY_SHIFT = 6;
    localparam int DROPPED        = FRACTION + QUIET_SHIFT;
    localparam int UPPER_BITS     = ACTIVITY_BITS - DROPPED;
    localparam int STEPS          = ACTIVITY_BITS;
    localparam int STEP_BITS      = $clog2(STEPS + 1);
    // an event is 256, and moves the usual number by 1/64 of that, which is not its lowest bit
    localparam int EVENT_AT       = FRACTION - ACTIVITY_SHIFT;

    logic [EVENTS_BITS-1:0]   events;
    logic [ACTIVITY_BITS-1:0] usual;

    // The window is not quiet if events << DROPPED >= usual: from the event on with which it has as
    // many as the upper bits of the usual number say, or one more, if the lower are not all 0. It
    // does not pause if events << DROPPED + 1 >= usual. Higher bits of the events are 0 until then.
    logic partly, any, more, half_more;
    // of the clock before: no window ends within two clocks of an event
    logic as_many, half_as_many, was_counted;

    assign quiet  = !any || !(more || (as_many && !partly));
    assign pauses = !any || !(half_more || (half_as_many && !partly && !usual[DROPPED]));

    // usual + events * 2^EVENT_AT - usual / 64, rounded up, from the lowest bit on: the bit of the
    // quotient is still in the register, until new ones come (`has_upper`). The events are shifted
    // out (`has_events`), which leaves none for the next window; the last of their bits comes with
    // the last of the quotient. If they have wrapped (`full`), all their bits are taken as 1.
    logic [STEP_BITS-1:0] step;
    logic                 borrow, carry, wrapped, full;

    // which bits are at hand; registers, as comparing the step takes its time
    logic has_events, has_upper, below_event, came_below;

    wire upper      = has_upper && usual[ACTIVITY_SHIFT];
    wire difference = usual[0] ^ upper ^ borrow;
    wire of_events  = has_events && (events[0] || (full && has_upper));
    wire next       = of_events ^ difference ^ carry;

    // not taken while events are shifted out: with the operand that is not 0 then, an FPGA has sum
    // and selection of a bit in one cell
    wire [EVENTS_BITS:0] one_more =
        {wrapped, events} + {1'b0, {EVENTS_BITS{has_events}}} + (EVENTS_BITS + 1)'(counted);

    always_ff @(posedge clk) begin
        if (load) {wrapped, events} <= '0;
        else {wrapped, events} <= has_events ? {1'b0, events >> 1} : one_more;
        if (load || (has_events && !has_upper)) full <= 1'b0;
        else if (wrapped) full <= 1'b1;
        if (window_end || load) begin
            any       <= 1'b0;
            more      <= 1'b0;
            half_more <= 1'b0;
        end else if (counted) any <= 1'b1;
        as_many      <= events[UPPER_BITS-1:0] == usual[ACTIVITY_BITS-1:DROPPED];
        half_as_many <= events[UPPER_BITS-2:0] == usual[ACTIVITY_BITS-1:DROPPED+1];
        was_counted  <= counted && !window_end && !load;
        if (as_many && was_counted) more <= 1'b1;
        if (half_as_many && was_counted) half_more <= 1'b1;
        if (window_end) begin
            settled     <= 1'b0;
            step        <= '0;
            borrow      <= usual[ACTIVITY_SHIFT-1:0] != 0;
            carry       <= 1'b0;
            partly      <= 1'b0;
            has_upper   <= 1'b1;
            below_event <= 1'b1;
            came_below  <= 1'b0;
        end else if (!settled) begin
            step    <= step + 1'b1;
            settled <= step == STEP_BITS'(STEPS - 1);
            borrow  <= (!usual[0] && (upper || borrow)) || (upper && borrow);
            carry   <= (of_events && (difference || carry)) || (difference && carry);
            usual   <= {next, usual[ACTIVITY_BITS-1:1]};
            // the bit that came with the clock before
            came_below <= below_event;
            if (came_below && usual[ACTIVITY_BITS-1]) partly <= 1'b1;
            if (step == STEP_BITS'(EVENT_AT - 1)) has_events <= 1'b1;
            if (step == STEP_BITS'(STEPS - 1)) has_events <= 1'b0;
            if (step == STEP_BITS'(ACTIVITY_BITS - ACTIVITY_SHIFT - 1)) has_upper <= 1'b0;
            if (step == STEP_BITS'(DROPPED - 1)) below_event <= 1'b0;
        end
        if (load) begin
            usual      <= start_activity;
            partly     <= start_activity[DROPPED-1:0] != 0;
            settled    <= 1'b1;
            has_events <= 1'b0;
        end
    end
endmodule
