// Table with a registered output. Its contents come from a file for $readmemh, or are written before
// they are read (LOADABLE), a word of the least significant bits of `load_word_i` at a time.
module vpr_rom #(
    parameter int DEPTH        = 2,
    parameter int BITS         = 1,
    parameter int ADDRESS_BITS = 1,
    parameter     FILE         = "",
    parameter bit LOADABLE     = 0,
    // verilator lint_off UNUSEDPARAM
    parameter     STYLE        = "auto"  // "block": in a block memory, however small
    // verilator lint_on UNUSEDPARAM
) (
    input  logic                    clk_i,
    input  logic                    enable_i,
    input  logic [ADDRESS_BITS-1:0] address_i,
    output logic [BITS-1:0]         word_o,
    input  logic                    load_i,
    input  logic [19:0]             load_address_i,
    input  logic [31:0]             load_word_i
);
    (* ram_style = STYLE *)
    logic [BITS-1:0] memory[0:DEPTH-1];

    generate
        if (LOADABLE) begin : g_loaded
            always_ff @(posedge clk_i)
                if (load_i) memory[load_address_i[ADDRESS_BITS-1:0]] <= load_word_i[BITS-1:0];
        end else if (FILE != "") begin : g_contents
            initial $readmemh(FILE, memory);
        end
    endgenerate

    always_ff @(posedge clk_i) if (enable_i) word_o <= memory[address_i];

    wire unused = &{1'b0, load_i, load_address_i, load_word_i};
endmodule
