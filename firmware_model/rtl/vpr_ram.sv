// Memory with one write port and one read port with a registered output. It starts undefined.
// A word that is written and read in one clock is read as either: no unit does so.
module vpr_ram #(
    parameter int DEPTH        = 2,
    parameter int BITS         = 1,
    parameter int ADDRESS_BITS = 1
) (
    input  logic                    clk,
    input  logic                    write,
    input  logic [ADDRESS_BITS-1:0] write_address,
    input  logic [BITS-1:0]         write_word,
    input  logic                    read,
    input  logic [ADDRESS_BITS-1:0] read_address,
    output logic [BITS-1:0]         read_word
);
    logic [BITS-1:0] memory[0:DEPTH-1];

    always_ff @(posedge clk) begin
        if (write) memory[write_address] <= write_word;
        if (read) read_word <= memory[read_address];
    end
endmodule
