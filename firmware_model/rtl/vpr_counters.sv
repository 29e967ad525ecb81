// Counters of a window, as it is open and while it is drained.
//
// While it is open, a slot is taken in each clock with `enable_i`: its count is read with the edge that
// takes it, raised by one, saturating, with the next, and written with the third, when `raised_o` and
// `raises_o` belong to it. A slot that comes again before that is raised from the newer count.
//
// While it is drained, and no slot is on its way (`draining_i`), `drain_slot_i` takes the same way with
// `drain_i`: it is read, `drained_o` and `read_slot_o` stay until the next, and in place of a raised
// count 0 is written. No slot is taken in the two clocks after that; `enable_i` is high meanwhile.
//
// With contrast codes a slot has a limit of events that count in a window: `in_limit_o` says that the
// raised count is one more than before, and not above it.
module vpr_counters #(
    localparam int SLOTS       = vpr_pkg::SLOTS,
    localparam int SLOT_BITS   = vpr_pkg::SLOT_BITS,
    localparam int COUNT_BITS  = vpr_pkg::COUNT_BITS,
    localparam bit CONTRAST    = vpr_pkg::CONTRAST,
    parameter  bit LOADABLE    = 0,
    parameter  bit SLOW_BLOCKS = 0  // see vpr_core
) (
    input  logic                  clk_i,
    input  logic                  rst_i,
    input  logic                  load_i,  // see vpr_rom
    input  logic [19:0]           load_address_i,
    input  logic [31:0]           load_word_i,
    input  logic                  enable_i,
    input  logic                  take_i,
    input  logic [SLOT_BITS-1:0]  slot_i,
    output logic                  raises_o,
    output logic                  in_limit_o,
    output logic [SLOT_BITS-1:0]  raised_slot_o,
    output logic [COUNT_BITS-1:0] raised_o,
    input  logic                  draining_i,
    input  logic                  drain_i,
    input  logic [SLOT_BITS-1:0]  drain_slot_i,
    output logic [COUNT_BITS-1:0] drained_o,
    output logic [SLOT_BITS-1:0]  read_slot_o
);
    // the slot whose count was read, and whether the one before it is the same, or one of the two
    logic                  reads_q, clears_q, same_1_q, same_q;
    logic                  writes_q;   // `raised_o`, or 0
    // the latest counts that were raised and written; COUNT_MAX is all ones, and where the highest bit is 1
    // they are COUNT_MAX, whatever the others
    logic [COUNT_BITS:0]   raised_q, written_q;

    assign raised_o = raised_q[COUNT_BITS-1:0] | {COUNT_BITS{raised_q[COUNT_BITS]}};

    wire [COUNT_BITS:0]   newer   = same_1_q ? raised_q : written_q;
    wire [COUNT_BITS:0]   count   = same_q ? newer : {1'b0, drained_o};
    wire [COUNT_BITS:0]   raised  = {1'b0, count[COUNT_BITS-1:0]} + 1'b1;
    wire                  read    = draining_i ? drain_i : enable_i;
    wire [SLOT_BITS-1:0]  address = draining_i ? drain_slot_i : slot_i;

    always_ff @(posedge clk_i) begin
        if (read) read_slot_o <= address;
        if (enable_i) begin
            reads_q       <= draining_i ? drain_i : take_i;
            clears_q      <= draining_i;
            same_1_q      <= reads_q && slot_i == read_slot_o;
            same_q        <= (reads_q && slot_i == read_slot_o)
                || (writes_q && slot_i == raised_slot_o);
            raises_o      <= reads_q && !clears_q;
            writes_q      <= reads_q;
            raised_slot_o <= read_slot_o;
            raised_q      <= clears_q ? '0 : raised | {count[COUNT_BITS], {COUNT_BITS{1'b0}}};
            written_q     <= raised_q;
        end
        // all counters are drained then, so that a last write does no harm
        if (rst_i) begin
            reads_q  <= 1'b0;
            raises_o <= 1'b0;
        end
    end

    vpr_ram #(
        .DEPTH(SLOTS), .BITS(COUNT_BITS), .ADDRESS_BITS(SLOT_BITS), .IN_LOGIC(SLOW_BLOCKS)
    ) counts (
        .clk_i          (clk_i),
        .write_i        (enable_i && writes_q),
        .write_address_i(raised_slot_o),
        .write_word_i   (raised_o),
        .read_i         (read),
        .read_address_i (address),
        .read_word_o    (drained_o)
    );

    generate
        if (CONTRAST) begin : g_limits
            logic [COUNT_BITS-1:0] limit, limit_q;

            vpr_rom #(
                .DEPTH(SLOTS), .BITS(COUNT_BITS), .ADDRESS_BITS(SLOT_BITS), .FILE("limits.mem"),
                .LOADABLE(LOADABLE)
            ) limits (
                .clk_i(clk_i), .enable_i(enable_i), .address_i(slot_i), .word_o(limit),
                .load_i(load_i), .load_address_i(load_address_i), .load_word_i(load_word_i)
            );

            always_ff @(posedge clk_i) if (enable_i) limit_q <= limit;

            assign in_limit_o = raised_q <= {1'b0, limit_q};
        end else begin : g_all
            wire unused = &{1'b0, load_i, load_address_i, load_word_i};
            assign in_limit_o = 1'b1;
        end
    endgenerate
endmodule
