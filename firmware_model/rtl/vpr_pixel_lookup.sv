// Slot of a pixel by row displacement: the entry of (column, row) is at column + displacement[row],
// and belongs to the pixel only if it names that row as its owner.
//
// A pixel is taken with `take`, where it stays until another is; its result is registered at the
// third clock edge with `enable` after that one, or at the fourth (SLOW_BLOCKS). Another pixel may
// come with each clock.
module vpr_pixel_lookup #(
    localparam int HEIGHT       = vpr_pkg::HEIGHT,
    localparam int PIXELS       = vpr_pkg::PIXELS,
    localparam bit POLARITY     = vpr_pkg::POLARITY,
    localparam int DEPTH        = vpr_pkg::LOOKUP_DEPTH,
    localparam int COLUMN_BITS  = vpr_pkg::COLUMN_BITS,
    localparam int ROW_BITS     = vpr_pkg::ROW_BITS,
    localparam int ADDRESS_BITS = vpr_pkg::ADDRESS_BITS,
    localparam int OWNER_BITS   = vpr_pkg::OWNER_BITS,
    localparam int SLOT_BITS    = vpr_pkg::SLOT_BITS,
    parameter  bit LOADABLE     = 0,
    parameter  bit SLOW_BLOCKS  = 0  // see vpr_core
) (
    input  logic                 clk,
    input  logic                 rst,
    input  logic [1:0]           load,  // see vpr_rom
    input  logic [19:0]          load_address,
    input  logic [31:0]          load_word,
    input  logic                 take,
    input  logic                 enable,
    input  logic [15:0]          column,
    input  logic [14:0]          row,
    input  logic                 on,
    output logic                 selected,
    output logic [SLOT_BITS-1:0] slot
);
    localparam int ENTRY_BITS = OWNER_BITS + SLOT_BITS;
    // of an entry as it is compared: behind the one that was read, if there is a register between
    localparam int HELD       = SLOW_BLOCKS ? ENTRY_BITS : 0;

    logic [ADDRESS_BITS-1:0]    displacement;
    logic [HELD+ENTRY_BITS-1:0] entry;

    // the pixel, and the one whose entry is compared, two steps later, or three
    logic [COLUMN_BITS-1:0]  held_column;
    logic [ROW_BITS-1:0]     held_row, entry_row;
    logic                    off_column, off_row, entry_off;
    logic                    second_half, entry_second;
    logic [ADDRESS_BITS-1:0] address;

    always_ff @(posedge clk) begin
        if (take) begin
            held_column <= column[COLUMN_BITS-1:0];
            held_row    <= row[ROW_BITS-1:0];
            // all bits of the input: an event from off the sensor is of no pixel. Columns from WIDTH
            // to 2^COLUMN_BITS, which is at most DEPTH, have entries that their row does not own.
            off_column  <= column != 16'(column[COLUMN_BITS-1:0]);
            off_row     <= {1'b0, row} >= 16'(HEIGHT);
            second_half <= POLARITY && !on;
        end
        if (enable) address <= ADDRESS_BITS'(held_column) + displacement;
    end

    vpr_delay #(
        .STEPS(SLOW_BLOCKS ? 3 : 2), .BITS(ROW_BITS + 2), .IN_LOGIC(SLOW_BLOCKS)
    ) pixels (
        .clk(clk), .rst(rst), .push(enable),
        .word({off_column || off_row, second_half, held_row}),
        .oldest({entry_off, entry_second, entry_row})
    );

    vpr_rom #(
        .DEPTH(HEIGHT), .BITS(ADDRESS_BITS), .ADDRESS_BITS(ROW_BITS),
        .FILE("displacement.mem"), .LOADABLE(LOADABLE)
    ) displacements (
        .clk(clk), .enable(take), .address(row[ROW_BITS-1:0]), .word(displacement),
        .load(load[0]), .load_address(load_address), .load_word(load_word)
    );

    vpr_rom #(
        .DEPTH(DEPTH), .BITS(ENTRY_BITS), .ADDRESS_BITS(ADDRESS_BITS),
        .FILE("lookup.mem"), .LOADABLE(LOADABLE)
    ) entries (
        .clk(clk), .enable(enable), .address(address), .word(entry[ENTRY_BITS-1:0]),
        .load(load[1]), .load_address(load_address), .load_word(load_word)
    );

    wire [OWNER_BITS-1:0] owner = entry[HELD+SLOT_BITS+:OWNER_BITS];

    generate
        if (SLOW_BLOCKS) begin : g_register
            logic [ENTRY_BITS-1:0] held_entry;
            always_ff @(posedge clk) if (enable) held_entry <= entry[ENTRY_BITS-1:0];
            assign entry[HELD+:ENTRY_BITS] = held_entry;
        end
    endgenerate

    always_ff @(posedge clk) begin
        if (enable) begin
            selected <= !entry_off && owner == OWNER_BITS'(entry_row);
            slot <= entry[HELD+:SLOT_BITS] + (entry_second ? SLOT_BITS'(PIXELS) : SLOT_BITS'(0));
        end
    end
endmodule
