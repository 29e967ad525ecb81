// Codes of all places, WORDS words each, in the order of places.mem. One address serves to load and
// to read them: it returns to the first word after the last, after reset and with `start`, in the
// clock after a window's end (`stop`). A load that a match interrupts begins again. They may also come from a file for $readmemh.
module vpr_place_memory #(
    localparam int PLACES       = vpr_pkg::PLACES,
    localparam int WORDS        = vpr_pkg::WORDS,
    localparam int WORD_BITS    = vpr_pkg::WORD_BITS,
    parameter      MEMORY_STYLE = "auto",
    parameter      FILE         = ""
) (
    input  logic                    clk,
    input  logic                    rst,
    input  logic                    busy,
    input  logic                    stop,
    input  logic                    s_place_tvalid,
    output logic                    s_place_tready,
    input  logic [WORD_BITS-1:0]    s_place_tdata,
    input  logic                    start,
    input  logic                    step,
    output logic                    last,
    output logic [WORD_BITS-1:0]    word
);
    localparam int ADDRESS_BITS = PLACES * WORDS > 1 ? $clog2(PLACES * WORDS) : 1;
    localparam logic [ADDRESS_BITS-1:0] LAST = ADDRESS_BITS'(PLACES * WORDS - 1);

    logic [ADDRESS_BITS-1:0] address;

    wire load = s_place_tvalid && s_place_tready;

    always_ff @(posedge clk) begin
        s_place_tready <= !busy && !stop && !rst;
        if (start || rst) begin
            address <= '0;
            last    <= LAST == 0;
        end else if (load || step) begin
            address <= last ? '0 : address + 1'b1;
            last    <= LAST == 0 || address == LAST - 1'b1;
        end
    end

    vpr_ram_single #(
        .DEPTH(PLACES * WORDS), .BITS(WORD_BITS), .ADDRESS_BITS(ADDRESS_BITS),
        .STYLE(MEMORY_STYLE), .FILE(FILE)
    ) places (
        .clk(clk), .write(load), .address(address),
        .write_word(s_place_tdata), .read_word(word)
    );
endmodule
