// Slot of a pixel by row displacement: the entry of (column, row) is at column + displacement[row],
// and belongs to the pixel only if it names that row as its owner.
//
// A pixel is taken with `take_i`, where it stays until another is; its result is registered at the
// third clock edge with `enable_i` after that one, or at the fourth (SLOW_BLOCKS). Another pixel may
// come with each clock.
module vpr_pixel_lookup #(
    localparam int HEIGHT       = vpr_pkg::HEIGHT,
    localparam int DEPTH        = vpr_pkg::LOOKUP_DEPTH,
    localparam int COLUMN_BITS  = vpr_pkg::COLUMN_BITS,
    localparam int ROW_BITS     = vpr_pkg::ROW_BITS,
    localparam int ADDRESS_BITS = vpr_pkg::ADDRESS_BITS,
    localparam int OWNER_BITS   = vpr_pkg::OWNER_BITS,
    localparam int SLOT_BITS    = vpr_pkg::SLOT_BITS,
    parameter  bit LOADABLE     = 0,
    parameter  bit SLOW_BLOCKS  = 0  // see vpr_core
) (
    input  logic                 clk_i,
    input  logic                 rst_i,
    input  logic [1:0]           load_i,  // see vpr_rom
    input  logic [19:0]          load_address_i,
    input  logic [31:0]          load_word_i,
    input  logic                 take_i,
    input  logic                 enable_i,
    input  logic [15:0]          column_i,
    input  logic [14:0]          row_i,
    output logic                 selected_o,
    output logic [SLOT_BITS-1:0] slot_o
);
    localparam int ENTRY_BITS = OWNER_BITS + SLOT_BITS;
    // of an entry as it is compared: behind the one that was read, if there is a register between
    localparam int HELD       = SLOW_BLOCKS ? ENTRY_BITS : 0;

    logic [ADDRESS_BITS-1:0]    displacement;
    logic [HELD+ENTRY_BITS-1:0] entry;

    // the pixel, and the one whose entry is compared, two steps later, or three
    logic [COLUMN_BITS-1:0]  held_column_q;
    logic [ROW_BITS-1:0]     held_row_q, entry_row;
    logic                    off_column_q, off_row_q, entry_off;
    logic [ADDRESS_BITS-1:0] address_q;

    always_ff @(posedge clk_i) begin
        if (take_i) begin
            held_column_q <= column_i[COLUMN_BITS-1:0];
            held_row_q    <= row_i[ROW_BITS-1:0];
            // all bits of the input: an event from off the sensor is of no pixel. Columns from WIDTH
            // to 2^COLUMN_BITS, which is at most DEPTH, have entries that their row does not own.
            off_column_q  <= column_i != 16'(column_i[COLUMN_BITS-1:0]);
            off_row_q     <= {1'b0, row_i} >= 16'(HEIGHT);
        end
        if (enable_i) address_q <= ADDRESS_BITS'(held_column_q) + displacement;
    end

    vpr_delay #(
        .STEPS(SLOW_BLOCKS ? 3 : 2), .BITS(ROW_BITS + 1), .IN_LOGIC(SLOW_BLOCKS)
    ) pixels (
        .clk_i(clk_i), .rst_i(rst_i), .push_i(enable_i),
        .word_i({off_column_q || off_row_q, held_row_q}), .oldest_o({entry_off, entry_row})
    );

    vpr_rom #(
        .DEPTH(HEIGHT), .BITS(ADDRESS_BITS), .ADDRESS_BITS(ROW_BITS),
        .FILE("displacement.mem"), .LOADABLE(LOADABLE)
    ) displacements (
        .clk_i(clk_i), .enable_i(take_i), .address_i(row_i[ROW_BITS-1:0]), .word_o(displacement),
        .load_i(load_i[0]), .load_address_i(load_address_i), .load_word_i(load_word_i)
    );

    vpr_rom #(
        .DEPTH(DEPTH), .BITS(ENTRY_BITS), .ADDRESS_BITS(ADDRESS_BITS),
        .FILE("lookup.mem"), .LOADABLE(LOADABLE)
    ) entries (
        .clk_i(clk_i), .enable_i(enable_i), .address_i(address_q), .word_o(entry[ENTRY_BITS-1:0]),
        .load_i(load_i[1]), .load_address_i(load_address_i), .load_word_i(load_word_i)
    );

    wire [OWNER_BITS-1:0] owner = entry[HELD+SLOT_BITS+:OWNER_BITS];

    generate
        if (SLOW_BLOCKS) begin : g_register
            logic [ENTRY_BITS-1:0] held_entry_q;
            always_ff @(posedge clk_i) if (enable_i) held_entry_q <= entry[ENTRY_BITS-1:0];
            assign entry[HELD+:ENTRY_BITS] = held_entry_q;
        end
    endgenerate

    always_ff @(posedge clk_i) begin
        if (enable_i) begin
            selected_o <= !entry_off && owner == OWNER_BITS'(entry_row);
            slot_o     <= entry[HELD+:SLOT_BITS];
        end
    end
endmodule
