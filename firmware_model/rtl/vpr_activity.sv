// Usual number of events in a window, and whether the open one pauses: it has none, or less than
// 1/16 of the usual number, which is told in units of 1/256 event.
//
// With `window_end` the usual number moves by 1/64 of its difference to the window's; the events of
// a window saturate. `pauses` is of the open window; it stands in the third clock after
// `window_end`.
module vpr_activity #(
    parameter int EVENTS_BITS   = 23,
    parameter int ACTIVITY_BITS = 31
) (
    input  logic                     clk,
    input  logic                     load,
    input  logic [ACTIVITY_BITS-1:0] start_activity,
    input  logic                     counted,
    input  logic                     window_end,
    output logic                     pauses
);
    localparam int FRACTION       = ACTIVITY_BITS - EVENTS_BITS;
    localparam int PAUSE_SHIFT    = 4;
    localparam int ACTIVITY_SHIFT = 6;
    localparam int DROPPED        = FRACTION + PAUSE_SHIFT;

    logic [EVENTS_BITS-1:0]          events;
    logic [ACTIVITY_BITS-1:0]        usual;
    logic signed [ACTIVITY_BITS:0]   difference;
    logic                            settles;

    // events << DROPPED < usual: with a borrow for the bits of the usual number below an event
    wire [EVENTS_BITS:0] above = {1'b0, events} - (EVENTS_BITS + 1)'(usual[ACTIVITY_BITS-1:DROPPED])
                                 - (EVENTS_BITS + 1)'(usual[DROPPED-1:0] != 0);

    assign pauses = events == 0 || above[EVENTS_BITS];

    wire signed [ACTIVITY_BITS:0] moves = difference >>> ACTIVITY_SHIFT;

    always_ff @(posedge clk) begin
        if (window_end || load) events <= EVENTS_BITS'(counted && !load);
        else if (counted && events != '1) events <= events + 1'b1;
        difference <= $signed({1'b0, events, {FRACTION{1'b0}}}) - $signed({1'b0, usual});
        settles    <= window_end && !load;
        if (load) usual <= start_activity;
        else if (settles) usual <= usual + moves[ACTIVITY_BITS-1:0];
    end

    wire unused = moves[ACTIVITY_BITS];
endmodule
