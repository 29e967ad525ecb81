// Sum of absolute differences of two words of LANES codes: the differences are registered, and so
// is each level of the adder tree. The result follows 1 + log2(LANES), rounded up, clocks later.
module vpr_sad_lanes #(
    parameter int LANES     = 1,
    parameter int CODE_BITS = 1,
    parameter int SUM_BITS  = 1
) (
    input  logic                       clk,
    input  logic [LANES*CODE_BITS-1:0] a,
    input  logic [LANES*CODE_BITS-1:0] b,
    output logic [SUM_BITS-1:0]        sum
);
    localparam int LEVELS = $clog2(LANES);
    localparam int WIDE   = 1 << LEVELS;

    genvar level, node;
    generate
        for (level = 0; level <= LEVELS; level = level + 1) begin : g_level
            localparam int NODES = WIDE >> level;
            localparam int BITS  = CODE_BITS + level;
            logic [NODES*BITS-1:0] sums;
            for (node = 0; node < NODES; node = node + 1) begin : g_node
                if (level > 0) begin : g_add
                    wire [BITS-2:0] left  = g_level[level-1].sums[(2*node)*(BITS-1)+:BITS-1];
                    wire [BITS-2:0] right = g_level[level-1].sums[(2*node+1)*(BITS-1)+:BITS-1];
                    always_ff @(posedge clk)
                        sums[node*BITS+:BITS] <= {1'b0, left} + {1'b0, right};
                end else if (node < LANES) begin : g_difference
                    wire [CODE_BITS-1:0] x = a[node*CODE_BITS+:CODE_BITS];
                    wire [CODE_BITS-1:0] y = b[node*CODE_BITS+:CODE_BITS];
                    always_ff @(posedge clk) sums[node*BITS+:BITS] <= x < y ? y - x : x - y;
                end else begin : g_filler
                    assign sums[node*BITS+:BITS] = '0;
                end
            end
        end
    endgenerate

    assign sum = SUM_BITS'(g_level[LEVELS].sums);
endmodule
