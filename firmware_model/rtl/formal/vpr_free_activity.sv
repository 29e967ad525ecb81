// Activity whose answers are free: it settles within 1 to 8 clocks of a window's end, and any window
// pauses or does not, with any activity. What is proved of a core with it holds for any numbers of
// events, and for the weight and the costs of any activity.
module vpr_activity #(
    localparam ACTIVITY_BITS = vpr_pkg::ACTIVITY_BITS
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
    (* anyseq *) logic       any_pause, at_once;
    (* anyseq *) logic [9:0] any_activity;
    logic [2:0]              left_q;

    assign pauses_o = any_pause;

    always_ff @(posedge clk_i) begin
        left_q <= left_q - 1'b1;
        if (load_i) settled_o <= 1'b1;
        else if (window_end_i) begin
            settled_o <= 1'b0;
            left_q    <= '1;
        end else if (!settled_o && (at_once || left_q == 0)) begin
            settled_o          <= 1'b1;
            activity_inverse_o <= any_activity;
        end
    end
endmodule
