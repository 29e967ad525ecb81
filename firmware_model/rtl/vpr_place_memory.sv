// Codes of all places, WORDS words each. s_place loads it in the order of places.mem, beginning at
// place 0 after reset and again after the last word; the matcher reads it meanwhile not.
module vpr_place_memory #(
    parameter int PLACES       = 1,
    parameter int WORDS        = 1,
    parameter int WORD_BITS    = 1,
    parameter int ADDRESS_BITS = 1
) (
    input  logic                    clk,
    input  logic                    rst,
    input  logic                    busy,
    input  logic                    s_place_tvalid,
    output logic                    s_place_tready,
    input  logic [WORD_BITS-1:0]    s_place_tdata,
    input  logic [ADDRESS_BITS-1:0] address,
    output logic [WORD_BITS-1:0]    word
);
    localparam logic [ADDRESS_BITS-1:0] LAST = ADDRESS_BITS'(PLACES * WORDS - 1);

    logic [ADDRESS_BITS-1:0] load_address;

    wire load = s_place_tvalid && s_place_tready;

    always_ff @(posedge clk) begin
        s_place_tready <= !busy && !rst;
        if (load) load_address <= load_address == LAST ? '0 : load_address + 1'b1;
        if (rst) load_address <= '0;
    end

    vpr_ram_single #(
        .DEPTH(PLACES * WORDS), .BITS(WORD_BITS), .ADDRESS_BITS(ADDRESS_BITS)
    ) places (
        .clk(clk), .write(load), .address(load ? load_address : address),
        .write_word(s_place_tdata), .read_word(word)
    );
endmodule
