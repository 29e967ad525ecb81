// Memories whose words are free: each read gives any word. What is proved of a core with them holds
// for any tables, places and memory contents, those that start undefined included.
module vpr_ram #(
    parameter DEPTH        = 2,
    parameter BITS         = 1,
    parameter ADDRESS_BITS = 1,
    parameter IN_LOGIC     = 0,
    parameter IN_BLOCK     = 0
) (
    input  logic                    clk,
    input  logic                    write,
    input  logic [ADDRESS_BITS-1:0] write_address,
    input  logic [BITS-1:0]         write_word,
    input  logic                    read,
    input  logic [ADDRESS_BITS-1:0] read_address,
    output logic [BITS-1:0]         read_word
);
    (* anyseq *) logic [BITS-1:0] any;
    always_ff @(posedge clk) if (read) read_word <= any;
endmodule

module vpr_ram_single #(
    parameter DEPTH        = 2,
    parameter BITS         = 1,
    parameter ADDRESS_BITS = 1,
    parameter STYLE        = "auto",
    parameter FILE         = ""
) (
    input  logic                    clk,
    input  logic                    write,
    input  logic [ADDRESS_BITS-1:0] address,
    input  logic [BITS-1:0]         write_word,
    output logic [BITS-1:0]         read_word
);
    (* anyseq *) logic [BITS-1:0] any;
    always_ff @(posedge clk) if (!write) read_word <= any;
endmodule

module vpr_rom #(
    parameter DEPTH        = 2,
    parameter BITS         = 1,
    parameter ADDRESS_BITS = 1,
    parameter FILE         = "",
    parameter LOADABLE     = 0,
    parameter STYLE        = "auto"
) (
    input  logic                    clk,
    input  logic                    enable,
    input  logic [ADDRESS_BITS-1:0] address,
    output logic [BITS-1:0]         word,
    input  logic                    load,
    input  logic [19:0]             load_address,
    input  logic [31:0]             load_word
);
    (* anyseq *) logic [BITS-1:0] any;
    always_ff @(posedge clk) if (enable) word <= any;
endmodule
