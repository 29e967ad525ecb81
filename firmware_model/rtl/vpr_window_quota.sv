// End of a window by count: it is full with its WINDOW_EVENTS-th event at a selected pixel, until the
// next window begins.
module vpr_window_quota #(
    localparam int          WINDOW_COUNT_BITS = vpr_pkg::WINDOW_COUNT_BITS,
    localparam logic [31:0] WINDOW_EVENTS     = vpr_pkg::WINDOW_EVENTS
) (
    input  logic clk,
    input  logic load,
    input  logic counted,
    input  logic next_window,
    output logic full
);
    localparam logic [WINDOW_COUNT_BITS-1:0] QUOTA = WINDOW_COUNT_BITS'(WINDOW_EVENTS);

    logic [WINDOW_COUNT_BITS-1:0] left;

    // the next event at a selected pixel is the window's last
    wire last = left == 1;

    always_ff @(posedge clk) begin
        if (load || (counted && last)) left <= QUOTA;
        else if (counted) left <= left - 1'b1;
        if (load || next_window) full <= 1'b0;
        else if (counted && last) full <= 1'b1;
    end
endmodule
