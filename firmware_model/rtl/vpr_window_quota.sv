// End of a window by count: it ends with its WINDOW_EVENTS-th event at a selected pixel.
module vpr_window_quota #(
    parameter int          WINDOW_COUNT_BITS = 1,
    parameter logic [31:0] WINDOW_EVENTS     = 1
) (
    input  logic clk,
    input  logic load,
    input  logic counted,
    output logic last
);
    localparam logic [WINDOW_COUNT_BITS-1:0] QUOTA = WINDOW_COUNT_BITS'(WINDOW_EVENTS);

    logic [WINDOW_COUNT_BITS-1:0] left;

    // the next event at a selected pixel is the window's last
    assign last = left == 1;

    always_ff @(posedge clk) begin
        if (load || (counted && last)) left <= QUOTA;
        else if (counted) left <= left - 1'b1;
    end
endmodule
