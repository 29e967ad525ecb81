// When vpr_window_timer says that a window is over, for any times. The end of the open window is kept
// here as a sum; the unit's own is seen through a port that the proof's script adds.
module vpr_window_timer_properties #(
    localparam TIMESTAMP_BITS = vpr_pkg::TIMESTAMP_BITS,
    localparam TAU_US         = vpr_pkg::TAU_US
) (
    input logic                      clk,
    input logic                      load,
    input logic [TIMESTAMP_BITS-1:0] start_time,
    input logic                      next_window,
    input logic                      take,
    input logic [TIMESTAMP_BITS-1:0] timestamp
);
    logic settled, over;
    logic [TIMESTAMP_BITS-1:0] end_inverse, behind;
    logic due;
    // the carry between the halves, which is added later
    wire  [TIMESTAMP_BITS-1:0] carried = TIMESTAMP_BITS'(due) << (TIMESTAMP_BITS / 2);

    vpr_window_timer window_timer (
        .clk_i(clk), .load_i(load), .start_time_i(start_time), .next_window_i(next_window),
        .take_i(take),
        .timestamp_i(timestamp), .settled_o(settled), .over_o(over), .end_inverse_q(end_inverse),
        .behind_q(behind),
        .due_q(due)
    );

    logic                      begun = 1'b0;
    logic                      taken;
    logic [TIMESTAMP_BITS-1:0] ends, time_taken;
    logic [TIMESTAMP_BITS-1:0] unsettled;

    wire signed [TIMESTAMP_BITS-1:0] rest = $signed(ends - time_taken);

    always_ff @(posedge clk) begin
        begun <= 1'b1;
        if (load) ends <= start_time + TAU_US;
        else if (next_window) ends <= ends + TAU_US;
        if (load) taken <= 1'b0;
        else if (take) taken <= 1'b1;
        if (take) time_taken <= timestamp;
        unsettled <= settled || load ? '0 : unsettled + 1'b1;
    end

    always_comb begin
        if (!begun) assume (load);
        if (!settled) assume (!take && !next_window);
        if (take) assume (!next_window);
    end

    always_comb begin
        if (begun && !load) begin
            if (settled && taken) assert (over == (rest <= 0));
            if (settled) assert (end_inverse == ~ends);
            if (settled && taken) assert (TIMESTAMP_BITS'(behind + carried) == -rest);
            assert (unsettled <= TIMESTAMP_BITS);
        end
    end
endmodule
