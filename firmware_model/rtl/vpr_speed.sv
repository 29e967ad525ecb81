// Mean speed of the drive, for filters with several gains: the running mean of the activity of its
// windows, unless they have few events, in units of 1/256 octave. It moves by all of its difference to
// the first of them, and by 1/2, 1/4 ... to 1/64 of that to later ones.
//
// A gain looks at the sum of the newest 1, 2 or 4 windows: the slower the drive by it, the longer.
// `rank_o` is of the highest gain, and each lower one has one less, down to 0: from 3 on it is the sum of
// four, from 1 on of two. It stands with `ready_o`, which falls with `settled_i`. `has_few_i` stands from
// three clocks after the first clock of `settled_i` on.
module vpr_speed (
    input  logic              clk_i,
    input  logic              rst_i,
    input  logic              settled_i,
    input  logic              has_few_i,
    input  logic [9:0]        activity_inverse_i,
    output logic              ready_o,
    output logic [3:0]        rank_o
);
    localparam int FRACTION = 4;

    logic [3:0]         settled_q;  // for so many clocks
    logic signed [13:0] speed_q;
    logic signed [14:0] difference_q;
    logic [6:0]         windows_q;       // that moved it, and one
    logic [6:0]         left_q;          // the same, halved as often as the difference, until it is 1
    logic               moves_q, stands_q;
    logic [6:0]         half_octaves_q;  // of the speed, rounded

    // 16 times the activity, less the speed
    wire [14:0] difference_inverse =
        {activity_inverse_i[9], activity_inverse_i, {FRACTION{1'b1}}} + {speed_q[13], speed_q};
    wire [6:0]  rank = 7'd1 - half_octaves_q;

    always_ff @(posedge clk_i) begin
        settled_q      <= settled_i ? {settled_q[2:0], 1'b1} : '0;
        moves_q        <= settled_q[3] && left_q == 7'd1;
        stands_q       <= settled_q[3] && left_q == 0 && !moves_q;
        ready_o        <= stands_q;
        half_octaves_q <= speed_q[13:7] + 7'(speed_q[6]);
        // above 9 it is of four for all gains
        rank_o         <= {4{!rank[6]}} & (rank[3:0] | {4{|rank[5:4]}});
        if (!settled_q[3]) begin
            difference_q <= ~difference_inverse;
            left_q       <= settled_q[2] && !has_few_i ? windows_q : '0;
        end else begin
            if (left_q[6:1] != 0) difference_q <= difference_q >>> 1;
            left_q <= left_q >> 1;
        end
        if (moves_q) begin
            speed_q <= 14'(15'(speed_q) + difference_q);
            if (!windows_q[6]) windows_q <= windows_q + 1'b1;
        end
        if (rst_i) begin
            settled_q <= '1;
            left_q    <= '0;
            moves_q   <= 1'b0;
            speed_q   <= '0;
            windows_q <= 7'd1;
        end
    end
endmodule
