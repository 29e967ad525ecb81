// End of a window by time, on a clock that wraps: what is left of the window at time t is
// end - t modulo 2^TIMESTAMP_BITS, read as a signed number. The window has ended if it is 0 or less.
//
// `ended` is registered at the second clock edge after `timestamp` or the window changed.
module vpr_window_timer #(
    parameter int          TIMESTAMP_BITS = 32,
    parameter logic [63:0] TAU_US         = 1
) (
    input  logic                      clk,
    input  logic                      load,
    input  logic [TIMESTAMP_BITS-1:0] start_time,
    input  logic                      next_window,
    input  logic [TIMESTAMP_BITS-1:0] timestamp,
    output logic                      ended
);
    localparam logic [TIMESTAMP_BITS-1:0] TAU = TIMESTAMP_BITS'(TAU_US);

    logic [TIMESTAMP_BITS-1:0] window_start;
    logic [TIMESTAMP_BITS-1:0] window_end;
    logic [TIMESTAMP_BITS-1:0] left;
    logic                      loaded;

    always_ff @(posedge clk) begin
        // a register between the choice and the adder: windows end several clocks apart
        window_start <= load ? start_time : window_end;
        loaded       <= load;
        if (loaded || next_window) window_end <= window_start + TAU;
        left  <= window_end - timestamp;
        ended <= left[TIMESTAMP_BITS-1] || left == 0;
    end
endmodule
