// Running mean of each counter of contrast codes, and the deviation of a count from it: the count's
// logarithm (a table, in units of 1/256 octave) less the mean.
//
// A slot a clock with `step_i`: `count_i` and `slot_i` belong together, `deviation_o` follows three
// steps later: that difference, half an octave for rounding, and 2^LEVEL_BITS, which makes it
// positive; with `deviates_o`, `deviating_last_o` and `deviating_slot_o`. It stays for one clock alone:
// no step is missing then. The mean then moves by
// 1/16 of the difference, in the end by 1/256, unless the window pauses (`hold_i`). While
// `clearing_i`, after reset, the means become those of the file.
//
// With several gains, the slots come once for each of SUMS sums of newest windows, which have means of
// their own; `newest_i` says that they are of the window alone.
module vpr_running_mean #(
    localparam int SLOTS      = vpr_pkg::SLOTS,
    localparam int SUMS       = vpr_pkg::SUMS,
    localparam int COUNT_MAX  = vpr_pkg::COUNT_MAX,
    localparam int SLOT_BITS  = vpr_pkg::SLOT_BITS,
    localparam int COUNT_BITS = vpr_pkg::COUNT_BITS,
    localparam int LEVEL_BITS = vpr_pkg::LEVEL_BITS,
    localparam int MEAN_BITS  = vpr_pkg::MEAN_BITS,
    parameter  bit LOADABLE   = 0
) (
    input  logic                  clk_i,
    input  logic                  rst_i,
    input  logic [1:0]            load_i,  // see vpr_rom
    input  logic [19:0]           load_address_i,
    input  logic [31:0]           load_word_i,
    input  logic                  step_i,
    input  logic                  clearing_i,
    input  logic                  hold_i,
    input  logic                  valid_i,
    input  logic                  last_i,
    input  logic                  newest_i,
    input  logic [SLOT_BITS-1:0]  slot_i,
    input  logic [COUNT_BITS-1:0] count_i,
    output logic                  deviates_o,
    output logic                  deviating_last_o,
    output logic [SLOT_BITS-1:0]  deviating_slot_o,
    output logic [LEVEL_BITS+1:0] deviation_o
);
    localparam int LEVEL_FRACTION  = 8;                       // fraction bits of a logarithm
    localparam int FRACTION    = MEAN_BITS - LEVEL_BITS;  // further ones of a mean
    localparam int MEANS       = SUMS * SLOTS;
    localparam int MEAN_AT     = SUMS > 1 ? $clog2(MEANS) : SLOT_BITS;
    localparam int FIRST_SHIFT = 4;
    localparam int LAST_SHIFT  = 8;
    // Half an octave for the code, and as much as makes the mean, which is taken away, round up
    localparam int ROUNDING    = (1 << (FRACTION + LEVEL_FRACTION - 1)) + (1 << (FRACTION - 1)) - 1
                                 + (1 << (LEVEL_BITS + FRACTION));

    logic [LEVEL_BITS-1:0]       level, first_mean;
    // as they are subtracted, in memory
    logic [MEAN_BITS-1:0]        total_inverse, moved_inverse_q;
    wire  [MEAN_BITS-1:0]        total = ~total_inverse;
    logic [MEAN_BITS-1:0]        held_total_q;
    logic signed [MEAN_BITS:0]   difference_q;
    logic                        read_valid_q, read_last_q, read_clearing_q;
    logic                        held_valid_q, held_last_q, held_clearing_q;
    logic [SLOT_BITS-1:0]        read_slot_q, held_slot_q;
    logic                        moving_valid_q, moved_valid_q;
    logic [SLOT_BITS-1:0]        moving_slot_q;
    logic [MEAN_BITS-1:0]        moving_total_q, moves_q;
    logic [MEAN_AT-1:0]          read_at, moved_at;  // among the means of all sums
    logic [LAST_SHIFT:0]         seen_q;  // windows, and 1 << FIRST_SHIFT; saturates

    // how far the mean moves: by less with each power of two of windows
    logic [LAST_SHIFT-FIRST_SHIFT:0] by_q;
    // the level less the mean, with a carry into the lowest bit
    wire [MEAN_BITS+1:0] above = {1'b0, level, {FRACTION{1'b0}}, 1'b1} + {1'b1, total_inverse, 1'b1};

    wire [MEAN_BITS:0] moves = ({(MEAN_BITS + 1){by_q[0]}} & (MEAN_BITS + 1)'(difference_q >>> 4))
                             | ({(MEAN_BITS + 1){by_q[1]}} & (MEAN_BITS + 1)'(difference_q >>> 5))
                             | ({(MEAN_BITS + 1){by_q[2]}} & (MEAN_BITS + 1)'(difference_q >>> 6))
                             | ({(MEAN_BITS + 1){by_q[3]}} & (MEAN_BITS + 1)'(difference_q >>> 7))
                             | ({(MEAN_BITS + 1){by_q[4]}} & (MEAN_BITS + 1)'(difference_q >>> 8));

    wire signed [MEAN_BITS+1:0] rounded =
        (MEAN_BITS + 2)'(difference_q) + $signed((MEAN_BITS + 2)'(ROUNDING));

    assign deviating_slot_o = moving_slot_q;

    vpr_rom #(
        .DEPTH(COUNT_MAX + 1), .BITS(LEVEL_BITS), .ADDRESS_BITS(COUNT_BITS), .FILE("levels.mem"),
        .LOADABLE(LOADABLE)
    ) levels (
        .clk_i(clk_i), .enable_i(step_i), .address_i(count_i), .word_o(level),
        .load_i(load_i[0]), .load_address_i(load_address_i), .load_word_i(load_word_i)
    );

    vpr_rom #(
        .DEPTH(SLOTS), .BITS(LEVEL_BITS), .ADDRESS_BITS(SLOT_BITS), .FILE("means.mem"),
        .LOADABLE(LOADABLE)
    ) first_means (
        .clk_i(clk_i), .enable_i(step_i), .address_i(slot_i), .word_o(first_mean),
        .load_i(load_i[1]), .load_address_i(load_address_i), .load_word_i(load_word_i)
    );

    vpr_ram #(
        .DEPTH(MEANS), .BITS(MEAN_BITS), .ADDRESS_BITS(MEAN_AT)
    ) means (
        .clk_i(clk_i), .write_i(moved_valid_q), .write_address_i(moved_at),
        .write_word_i(moved_inverse_q),
        .read_i(step_i), .read_address_i(read_at), .read_word_o(total_inverse)
    );

    generate
        if (SUMS == 1) begin : g_one
            logic [SLOT_BITS-1:0] moved_slot_q;
            assign read_at  = slot_i;
            assign moved_at = moved_slot_q;
            always_ff @(posedge clk_i) moved_slot_q <= moving_slot_q;
        end else begin : g_several
            // in the order in which the slots of all sums come
            logic [MEAN_AT-1:0] read_at_q, moved_at_q;
            logic               moving_q, moved_q;  // whether or not a mean moves
            assign read_at  = read_at_q;
            assign moved_at = moved_at_q;
            always_ff @(posedge clk_i) begin
                moving_q <= held_valid_q;
                moved_q  <= moving_q;
                if (step_i && valid_i)
                    read_at_q <= read_at_q == MEAN_AT'(MEANS - 1) ? '0 : read_at_q + 1'b1;
                if (moved_q) moved_at_q <= moved_at_q == MEAN_AT'(MEANS - 1) ? '0 : moved_at_q + 1'b1;
                if (rst_i) begin
                    moving_q   <= 1'b0;
                    moved_q    <= 1'b0;
                    read_at_q  <= '0;
                    moved_at_q <= '0;
                end
            end
        end
    endgenerate

    always_ff @(posedge clk_i) begin
        if (step_i) begin
            read_valid_q    <= valid_i;
            read_last_q     <= last_i;
            read_clearing_q <= clearing_i;
            read_slot_q     <= slot_i;
            held_valid_q    <= read_valid_q;
            held_last_q     <= read_last_q;
            held_clearing_q <= read_clearing_q;
            held_slot_q     <= read_slot_q;
            held_total_q    <= read_clearing_q ? {first_mean, {FRACTION{1'b0}}} : total;
            difference_q    <= read_clearing_q ? '0 : (MEAN_BITS + 1)'(above >> 1);
            deviation_o     <= rounded[MEAN_BITS+1-:LEVEL_BITS+2];
            if (held_last_q && newest_i && !held_clearing_q && !hold_i && !seen_q[LAST_SHIFT])
                seen_q <= seen_q + 1'b1;
        end
        moving_valid_q  <= held_valid_q && (held_clearing_q || !hold_i);
        moving_slot_q   <= held_slot_q;
        moving_total_q  <= held_total_q;
        moves_q         <= moves[MEAN_BITS-1:0];
        moved_valid_q   <= moving_valid_q;
        moved_inverse_q <= ~(moving_total_q + moves_q);
        deviates_o       <= held_valid_q && !held_clearing_q;
        deviating_last_o <= held_last_q;
        // the highest power of two that it has reached
        by_q <= seen_q[8] ? 5'b10000 : seen_q[7] ? 5'b01000 : seen_q[6] ? 5'b00100
              : seen_q[5] ? 5'b00010 : 5'b00001;
        if (rst_i) begin
            moving_valid_q <= 1'b0;
            moved_valid_q  <= 1'b0;
            deviates_o     <= 1'b0;
            read_valid_q   <= 1'b0;
            read_last_q    <= 1'b0;
            held_valid_q   <= 1'b0;
            held_last_q    <= 1'b0;
            seen_q         <= (LAST_SHIFT + 1)'(1 << FIRST_SHIFT);
        end
    end

    wire unused = &{1'b0, rounded, moves, above};
endmodule
