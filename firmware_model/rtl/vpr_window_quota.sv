// End of a window by count: it is full with its WINDOW_EVENTS-th event at a selected pixel, until the
// next window begins.
module vpr_window_quota #(
    localparam int          WINDOW_COUNT_BITS = vpr_pkg::WINDOW_COUNT_BITS,
    localparam logic [31:0] WINDOW_EVENTS     = vpr_pkg::WINDOW_EVENTS
) (
    input  logic clk_i,
    input  logic load_i,
    input  logic counted_i,
    input  logic next_window_i,
    output logic full_o
);
    localparam logic [WINDOW_COUNT_BITS-1:0] QUOTA = WINDOW_COUNT_BITS'(WINDOW_EVENTS);

    logic [WINDOW_COUNT_BITS-1:0] left_q;

    // the next event at a selected pixel is the window's last
    wire last = left_q == 1;

    always_ff @(posedge clk_i) begin
        if (load_i || (counted_i && last)) left_q <= QUOTA;
        else if (counted_i) left_q <= left_q - 1'b1;
        if (load_i || next_window_i) full_o <= 1'b0;
        else if (counted_i && last) full_o <= 1'b1;
    end
endmodule
