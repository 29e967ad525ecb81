// Codes of all places, WORDS words each, in the order of places.mem. One address serves to load and
// to read them: it returns to the first word after the last, after reset and with `start_i`, in the
// clock after a window's end (`stop_i`). Words wait while a match is computed (`busy_i`), and a load
// that it interrupts begins again. They may also come from a file for $readmemh.
module vpr_place_memory #(
    localparam int PLACES       = vpr_pkg::PLACES,
    localparam int WORDS        = vpr_pkg::WORDS,
    localparam int WORD_BITS    = vpr_pkg::WORD_BITS,
    parameter      MEMORY_STYLE = "auto",
    parameter      FILE         = ""
) (
    input  logic                    clk_i,
    input  logic                    rst_i,
    input  logic                    busy_i,
    input  logic                    stop_i,
    input  logic                    s_place_tvalid,
    output logic                    s_place_tready,
    input  logic [WORD_BITS-1:0]    s_place_tdata,
    input  logic                    start_i,
    input  logic                    step_i,
    output logic                    last_o,
    output logic [WORD_BITS-1:0]    word_o
);
    localparam int ADDRESS_BITS = PLACES * WORDS > 1 ? $clog2(PLACES * WORDS) : 1;
    localparam logic [ADDRESS_BITS-1:0] LAST = ADDRESS_BITS'(PLACES * WORDS - 1);

    logic [ADDRESS_BITS-1:0] address_q;

    wire load = s_place_tvalid && s_place_tready;

    always_ff @(posedge clk_i) begin
        s_place_tready <= !busy_i && !stop_i && !rst_i;
        if (start_i || rst_i) begin
            address_q <= '0;
            last_o    <= LAST == 0;
        end else if (load || step_i) begin
            address_q <= last_o ? '0 : address_q + 1'b1;
            last_o    <= LAST == 0 || address_q == LAST - 1'b1;
        end
    end

    vpr_ram_single #(
        .DEPTH(PLACES * WORDS), .BITS(WORD_BITS), .ADDRESS_BITS(ADDRESS_BITS),
        .STYLE(MEMORY_STYLE), .FILE(FILE)
    ) places (
        .clk_i(clk_i), .write_i(load), .address_i(address_q),
        .write_word_i(s_place_tdata), .read_word_o(word_o)
    );
endmodule
