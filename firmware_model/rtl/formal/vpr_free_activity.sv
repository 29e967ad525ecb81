// Activity whose answers are free: it settles within 1 to 8 clocks of a window's end, and any window
// pauses or does not, with any activity. What is proved of a core with it holds for any numbers of
// events, and for the weight and the costs of any activity.
module vpr_activity #(
    localparam ACTIVITY_BITS = vpr_pkg::ACTIVITY_BITS
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
    (* anyseq *) logic       any_pause, at_once;
    (* anyseq *) logic [9:0] any_activity;
    logic [2:0]              left;

    assign pauses = any_pause;

    always_ff @(posedge clk) begin
        left <= left - 1'b1;
        if (load) settled <= 1'b1;
        else if (window_end) begin
            settled <= 1'b0;
            left    <= '1;
        end else if (!settled && (at_once || left == 0)) begin
            settled          <= 1'b1;
            activity_inverse <= any_activity;
        end
    end
endmodule
