// Code of a count against the running mean of its counter: the count's logarithm (a table, in units
// of 1/256 octave) less the mean, rounded to octaves, saturated, plus half the range.
//
// A slot a clock with `step`: `count` and `slot` belong together, `code` follows three steps later. So
// does `deviation`, for codes of contrast (CONTRAST): that difference, half an octave for rounding, and
// 2^ENTRY_BITS, which makes it positive; with `deviates`, `deviating_last` and `deviating_slot`. It
// stays for one clock alone: no step is missing then.
// The mean then moves by 1/16 of the difference, in the end by 1/256, unless the window pauses
// (`hold`). While `clearing`, after reset, the means become those of the file.
module vpr_own_mean #(
    localparam int SLOTS      = vpr_pkg::SLOTS,
    localparam int COUNT_MAX  = vpr_pkg::COUNT_MAX,
    localparam int SLOT_BITS  = vpr_pkg::SLOT_BITS,
    localparam int COUNT_BITS = vpr_pkg::COUNT_BITS,
    localparam int ENTRY_BITS = vpr_pkg::ENTRY_BITS,
    localparam int MEAN_BITS  = vpr_pkg::MEAN_BITS,
    localparam int CODE_BITS  = vpr_pkg::CODE_BITS,
    localparam bit CONTRAST   = vpr_pkg::CONTRAST,
    parameter  bit LOADABLE   = 0
) (
    input  logic                  clk,
    input  logic                  rst,
    input  logic [1:0]            load,  // see vpr_rom
    input  logic [19:0]           load_address,
    input  logic [31:0]           load_word,
    input  logic                  step,
    input  logic                  clearing,
    input  logic                  hold,
    input  logic                  valid,
    input  logic                  last,
    input  logic [SLOT_BITS-1:0]  slot,
    input  logic [COUNT_BITS-1:0] count,
    output logic [CODE_BITS-1:0]  code,
    output logic                  deviates,
    output logic                  deviating_last,
    output logic [SLOT_BITS-1:0]  deviating_slot,
    output logic [ENTRY_BITS+1:0] deviation
);
    localparam int LEVEL_BITS  = 8;                       // fraction bits of a logarithm
    localparam int FRACTION    = MEAN_BITS - ENTRY_BITS;  // further ones of a mean
    localparam int FIRST_SHIFT = 4;
    localparam int LAST_SHIFT  = 8;
    // Half an octave for the code, and as much as makes the mean, which is taken away, round up
    localparam int ROUNDING    = (1 << (FRACTION + LEVEL_BITS - 1)) + (1 << (FRACTION - 1)) - 1
                                 + (CONTRAST ? 1 << (ENTRY_BITS + FRACTION) : 0);
    localparam int WHOLE_BITS  = MEAN_BITS + 2 - FRACTION - LEVEL_BITS;
    localparam int OCTAVE_BITS = WHOLE_BITS > CODE_BITS + 1 ? WHOLE_BITS : CODE_BITS + 1;

    localparam logic [CODE_BITS-1:0] HALF = CODE_BITS'(1 << (CODE_BITS - 1));

    logic [ENTRY_BITS-1:0]       level, first_mean;
    // as they are subtracted, in memory
    logic [MEAN_BITS-1:0]        total_inverse, moved_inverse;
    wire  [MEAN_BITS-1:0]        total = ~total_inverse;
    logic [MEAN_BITS-1:0]        held_total;
    logic signed [MEAN_BITS:0]   difference;
    logic                        read_valid, read_last, read_clearing;
    logic                        held_valid, held_last, held_clearing;
    logic [SLOT_BITS-1:0]        read_slot, held_slot;
    logic                        moved_valid;
    logic [SLOT_BITS-1:0]        moved_slot;
    logic [LAST_SHIFT:0]         seen;  // windows, and 1 << FIRST_SHIFT; saturates

    // how far the mean moves: by less with each power of two of windows
    logic [LAST_SHIFT-FIRST_SHIFT:0] by;
    // the level less the mean, with a carry into the lowest bit
    wire [MEAN_BITS+1:0] above = {1'b0, level, {FRACTION{1'b0}}, 1'b1} + {1'b1, total_inverse, 1'b1};

    wire [MEAN_BITS:0] moves = ({(MEAN_BITS + 1){by[0]}} & (MEAN_BITS + 1)'(difference >>> 4))
                             | ({(MEAN_BITS + 1){by[1]}} & (MEAN_BITS + 1)'(difference >>> 5))
                             | ({(MEAN_BITS + 1){by[2]}} & (MEAN_BITS + 1)'(difference >>> 6))
                             | ({(MEAN_BITS + 1){by[3]}} & (MEAN_BITS + 1)'(difference >>> 7))
                             | ({(MEAN_BITS + 1){by[4]}} & (MEAN_BITS + 1)'(difference >>> 8));

    wire signed [MEAN_BITS+1:0] rounded =
        (MEAN_BITS + 2)'(difference) + $signed((MEAN_BITS + 2)'(ROUNDING));
    logic signed [OCTAVE_BITS-1:0] octaves;
    // in range if the bits from the code's highest on are all as the sign
    wire   below  = octaves[OCTAVE_BITS-1];
    wire   beyond = octaves[OCTAVE_BITS-1:CODE_BITS-1] != {(OCTAVE_BITS - CODE_BITS + 1){below}};
    assign code   = beyond ? {CODE_BITS{!below}} : octaves[CODE_BITS-1:0] ^ HALF;

    assign deviating_slot = moved_slot;

    vpr_rom #(
        .DEPTH(COUNT_MAX + 1), .BITS(ENTRY_BITS), .ADDRESS_BITS(COUNT_BITS), .FILE("codes.mem"),
        .LOADABLE(LOADABLE)
    ) levels (
        .clk(clk), .enable(step), .address(count), .word(level),
        .load(load[0]), .load_address(load_address), .load_word(load_word)
    );

    vpr_rom #(
        .DEPTH(SLOTS), .BITS(ENTRY_BITS), .ADDRESS_BITS(SLOT_BITS), .FILE("means.mem"),
        .LOADABLE(LOADABLE)
    ) first_means (
        .clk(clk), .enable(step), .address(slot), .word(first_mean),
        .load(load[1]), .load_address(load_address), .load_word(load_word)
    );

    vpr_ram #(
        .DEPTH(SLOTS), .BITS(MEAN_BITS), .ADDRESS_BITS(SLOT_BITS)
    ) means (
        .clk(clk), .write(moved_valid), .write_address(moved_slot), .write_word(moved_inverse),
        .read(step), .read_address(slot), .read_word(total_inverse)
    );

    always_ff @(posedge clk) begin
        if (step) begin
            read_valid    <= valid;
            read_last     <= last;
            read_clearing <= clearing;
            read_slot     <= slot;
            held_valid    <= read_valid;
            held_last     <= read_last;
            held_clearing <= read_clearing;
            held_slot     <= read_slot;
            held_total    <= read_clearing ? {first_mean, {FRACTION{1'b0}}} : total;
            difference    <= read_clearing ? '0 : (MEAN_BITS + 1)'(above >> 1);
            octaves       <= OCTAVE_BITS'($signed(rounded[MEAN_BITS+1-:WHOLE_BITS]));
            deviation     <= rounded[MEAN_BITS+1-:ENTRY_BITS+2];
            if (held_last && !held_clearing && !hold && !seen[LAST_SHIFT]) seen <= seen + 1'b1;
        end
        moved_valid <= held_valid && (held_clearing || !hold);
        moved_slot  <= held_slot;
        deviates       <= held_valid && !held_clearing;
        deviating_last <= held_last;
        moved_inverse <= ~(held_total + moves[MEAN_BITS-1:0]);
        // the highest power of two that it has reached
        by <= seen[8] ? 5'b10000 : seen[7] ? 5'b01000 : seen[6] ? 5'b00100
              : seen[5] ? 5'b00010 : 5'b00001;
        if (rst) begin
            moved_valid <= 1'b0;
            deviates    <= 1'b0;
            read_valid  <= 1'b0;
            read_last   <= 1'b0;
            held_valid  <= 1'b0;
            held_last   <= 1'b0;
            seen        <= (LAST_SHIFT + 1)'(1 << FIRST_SHIFT);
        end
    end

    wire unused = &{1'b0, rounded, moves, above};
endmodule
