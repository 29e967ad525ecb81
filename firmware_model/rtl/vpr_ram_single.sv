// Memory with one port that writes or reads in a clock, as the large memories of small FPGAs have
// it. It starts undefined, but for a FILE; while it is written, its output keeps its value. STYLE is what yosys
// makes of it: "huge" is the SPRAM of an iCE40UP5K, "auto" its own choice.
module vpr_ram_single #(
    parameter int DEPTH        = 2,
    parameter int BITS         = 1,
    parameter int ADDRESS_BITS = 1,
    // verilator lint_off UNUSEDPARAM
    parameter     STYLE        = "auto",
    // verilator lint_on UNUSEDPARAM
    parameter     FILE         = ""
) (
    input  logic                    clk,
    input  logic                    write,
    input  logic [ADDRESS_BITS-1:0] address,
    input  logic [BITS-1:0]         write_word,
    output logic [BITS-1:0]         read_word
);
    (* ram_style = STYLE *)
    logic [BITS-1:0] memory[0:DEPTH-1];

    generate
        if (FILE != "") begin : g_contents
            initial $readmemh(FILE, memory);
        end
    endgenerate

    always_ff @(posedge clk) begin
        if (write) memory[address] <= write_word;
        else read_word <= memory[address];
    end
endmodule
