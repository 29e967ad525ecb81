// Sum of absolute differences of two words of LANES codes, one of which comes inverted, as a
// subtraction takes it. The differences are registered, and so is each level of the adder tree. The
// result is `sum_o` + `lacks_o`, and follows 1 + log2(LANES), rounded up, clocks later.
module vpr_sad_lanes #(
    localparam int LANES     = vpr_pkg::LANES,
    localparam int CODE_BITS = vpr_pkg::CODE_BITS,
    localparam int SUM_BITS  = vpr_pkg::SAD_BITS
) (
    input  logic                       clk_i,
    input  logic [LANES*CODE_BITS-1:0] a_i,
    input  logic [LANES*CODE_BITS-1:0] b_inverse_i,
    output logic [SUM_BITS-1:0]        sum_o,
    output logic                       lacks_o
);
    localparam int LEVELS = $clog2(LANES);
    localparam int WIDE   = 1 << LEVELS;

    // The inverse of a negative difference is its magnitude less one. That one is not added here: each
    // node hands on what its own sum lacks, of which the adder that follows takes one as its carry.
    genvar level, node;
    generate
        for (level = 0; level <= LEVELS; level = level + 1) begin : g_level
            localparam int NODES = WIDE >> level;
            localparam int BITS  = CODE_BITS + level;
            wire [NODES*BITS-1:0] sums;
            wire [NODES-1:0]      lacking;
            for (node = 0; node < NODES; node = node + 1) begin : g_node
                logic [BITS-1:0] node_sum;
                logic            node_lacks;
                assign sums[node*BITS+:BITS] = node_sum;
                assign lacking[node]         = node_lacks;
                if (level > 0) begin : g_add
                    wire [BITS-2:0] left  = g_level[level-1].sums[(2*node)*(BITS-1)+:BITS-1];
                    wire [BITS-2:0] right = g_level[level-1].sums[(2*node+1)*(BITS-1)+:BITS-1];
                    wire            carry = g_level[level-1].lacking[2*node];
                    always_ff @(posedge clk_i) begin
                        node_sum   <= BITS'(({1'b0, left, 1'b1} + {1'b0, right, carry}) >> 1);
                        node_lacks <= g_level[level-1].lacking[2*node+1];
                    end
                end else if (node < LANES) begin : g_difference
                    // a - b, with a carry into the lowest bit
                    wire [CODE_BITS+1:0] sum_of_both =
                        {1'b0, a_i[node*CODE_BITS+:CODE_BITS], 1'b1}
                        + {1'b1, b_inverse_i[node*CODE_BITS+:CODE_BITS], 1'b1};
                    wire [CODE_BITS:0] difference = sum_of_both[CODE_BITS+1:1];
                    wire unused = sum_of_both[0];
                    wire negative = difference[CODE_BITS];
                    always_ff @(posedge clk_i) begin
                        node_sum   <= difference[BITS-1:0] ^ {BITS{negative}};
                        node_lacks <= negative;
                    end
                end else begin : g_filler
                    assign node_sum   = '0;
                    assign node_lacks = 1'b0;
                end
            end
        end
    endgenerate

    assign sum_o   = SUM_BITS'(g_level[LEVELS].sums);
    assign lacks_o = g_level[LEVELS].lacking[0];
endmodule
