// What vpr_delay must return, with pushes at any times: properties for the model checker pdr. One
// push, chosen freely, stands for all.
module vpr_delay_properties #(
    parameter STEPS = 4,
    parameter BITS  = 2
) (
    input logic            clk,
    input logic            rst,
    input logic            push,
    input logic [BITS-1:0] word,
    input logic            choose
);
    localparam COUNT_BITS = $clog2(STEPS + 1);

    logic [BITS-1:0] oldest;

    vpr_delay #(
        .STEPS(STEPS), .BITS(BITS)
    ) delay (
        .clk_i(clk), .rst_i(rst), .push_i(push), .word_i(word), .oldest_o(oldest)
    );

    logic                  begun = 1'b0;
    logic [COUNT_BITS-1:0] since;  // pushes from the chosen one on, itself included
    logic [BITS-1:0]       chosen;

    always_ff @(posedge clk) begin
        begun <= 1'b1;
        if (push && since != 0) since <= since == STEPS ? '0 : since + 1'b1;
        if (push && choose && since == 0) begin
            since  <= 1;
            chosen <= word;
        end
        if (rst) since <= '0;
    end

    always_comb begin
        if (!begun) assume (rst);
        if (begun && !rst && since == STEPS) assert (oldest == chosen);
    end
endmodule
