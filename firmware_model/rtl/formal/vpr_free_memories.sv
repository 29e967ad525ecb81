// Memories whose words are free: each read gives any word. What is proved of a core with them holds
// for any tables, places and memory contents, those that start undefined included.
module vpr_ram #(
    parameter DEPTH        = 2,
    parameter BITS         = 1,
    parameter ADDRESS_BITS = 1,
    parameter IN_LOGIC     = 0,
    parameter IN_BLOCK     = 0
) (
    input  logic                    clk_i,
    input  logic                    write_i,
    input  logic [ADDRESS_BITS-1:0] write_address_i,
    input  logic [BITS-1:0]         write_word_i,
    input  logic                    read_i,
    input  logic [ADDRESS_BITS-1:0] read_address_i,
    output logic [BITS-1:0]         read_word_o
);
    (* anyseq *) logic [BITS-1:0] any;
    always_ff @(posedge clk_i) if (read_i) read_word_o <= any;
endmodule

module vpr_ram_single #(
    parameter DEPTH        = 2,
    parameter BITS         = 1,
    parameter ADDRESS_BITS = 1,
    parameter STYLE        = "auto",
    parameter FILE         = ""
) (
    input  logic                    clk_i,
    input  logic                    write_i,
    input  logic [ADDRESS_BITS-1:0] address_i,
    input  logic [BITS-1:0]         write_word_i,
    output logic [BITS-1:0]         read_word_o
);
    (* anyseq *) logic [BITS-1:0] any;
    always_ff @(posedge clk_i) if (!write_i) read_word_o <= any;
endmodule

module vpr_rom #(
    parameter DEPTH        = 2,
    parameter BITS         = 1,
    parameter ADDRESS_BITS = 1,
    parameter FILE         = "",
    parameter LOADABLE     = 0,
    parameter STYLE        = "auto"
) (
    input  logic                    clk_i,
    input  logic                    enable_i,
    input  logic [ADDRESS_BITS-1:0] address_i,
    output logic [BITS-1:0]         word_o,
    input  logic                    load_i,
    input  logic [19:0]             load_address_i,
    input  logic [31:0]             load_word_i
);
    (* anyseq *) logic [BITS-1:0] any;
    always_ff @(posedge clk_i) if (enable_i) word_o <= any;
endmodule
