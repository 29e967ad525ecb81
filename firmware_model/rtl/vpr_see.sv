// What the number of events of a window says: how much its evidence weighs, in eighths, and whether
// the robot stands, from the window's activity less that of the place of the window before.
//
// This surplus, in sixteenths of an octave, gives all weight from -40 on, and none below -54. Below
// -48, or in a pause, the window has few events; from the third one in a row on, the robot stands.
// Without a place (`placed_i`) evidence has all its weight, and pauses alone have few events.
// `slack_i` is 55, and as much more as the gain of the best place is below 0.
//
// `is_best_i` says that `of_place_i` is the activity of the best place, for the next window. Results
// stand from three clocks after the first clock of `settled_i` on, which comes with the activity, to the
// same clock of the next window.
module vpr_see (
    input  logic       clk_i,
    input  logic       rst_i,
    input  logic       is_best_i,
    input  logic [7:0] of_place_i,
    input  logic [6:0] slack_i,
    input  logic       placed_i,
    input  logic       paused_i,
    input  logic       settled_i,
    input  logic [9:0] activity_inverse_i,
    output logic [3:0] weight_o,
    output logic       has_few_o,  // events
    output logic       stands_o
);
    localparam logic [1:0] PATIENCE = 2'd2;

    logic        settled_q, comes_q, judges_q;
    logic [9:0]  allowance_q;  // the slack less the activity of the best place
    logic [9:0]  eighths_q;    // of the weight: half of the surplus and 56
    logic        has_few_q;
    logic [1:0]  few_q;        // windows with few events in a row, to one more than PATIENCE

    wire [10:0] surplus =
        {allowance_q[9], allowance_q} - {activity_inverse_i[9], activity_inverse_i};
    wire        none    = eighths_q[9];
    wire        all     = !none && |eighths_q[8:3];

    assign has_few_o = few_q != 0;
    assign stands_o  = few_q > PATIENCE;

    always_ff @(posedge clk_i) begin
        settled_q <= settled_i;
        comes_q   <= settled_i && !settled_q;
        judges_q  <= comes_q;
        has_few_q <= paused_i || (placed_i && (none || (!all && !eighths_q[2])));
        if (is_best_i) allowance_q <= 10'(slack_i) - {{2{of_place_i[7]}}, of_place_i};
        eighths_q <= surplus[10:1];
        weight_o  <= !placed_i || all ? 4'd8 : none ? 4'd0 : {1'b0, eighths_q[2:0]};
        if (judges_q) few_q <= !has_few_q ? '0 : stands_o ? few_q : few_q + 1'b1;
        if (rst_i) begin
            settled_q <= 1'b1;
            comes_q   <= 1'b0;
            judges_q  <= 1'b0;
            few_q     <= '0;
        end
    end

    wire unused = &{1'b0, surplus[0]};
endmodule
