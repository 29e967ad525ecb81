// What vpr_counters must count, for any slots at any times: properties for the model checker pdr.
// One slot `k`, chosen freely and kept, stands for all.
module vpr_counters_properties #(
    localparam SLOTS      = vpr_pkg::SLOTS,
    localparam SLOT_BITS  = vpr_pkg::SLOT_BITS,
    localparam COUNT_BITS = vpr_pkg::COUNT_BITS,
    localparam COUNT_MAX  = vpr_pkg::COUNT_MAX
) (
    input logic                 clk,
    input logic                 rst,
    input logic                 enable,
    input logic                 take,
    input logic [SLOT_BITS-1:0] slot,
    input logic                 draining,
    input logic                 drain,
    input logic [SLOT_BITS-1:0] drain_slot
);
    (* anyconst *) logic [SLOT_BITS-1:0] k;

    logic                  raises;
    logic [SLOT_BITS-1:0]  raised_slot, read_slot;
    logic [COUNT_BITS-1:0] raised, drained;

    vpr_counters counters (
        .clk_i(clk), .rst_i(rst), .enable_i(enable), .take_i(take),
        .slot_i(slot), .raises_o(raises), .raised_slot_o(raised_slot), .raised_o(raised),
        .draining_i(draining),
        .drain_i(drain), .drain_slot_i(drain_slot), .drained_o(drained), .read_slot_o(read_slot)
    );

    // the count of `k`, which is known once it was cleared; and slots that are on their way
    logic                  begun = 1'b0;
    logic                  known, read_k;
    logic [1:0]            under_way, drains, after;
    logic [SLOT_BITS-1:0]  newer_slot, drained_slot;
    logic [COUNT_BITS-1:0] k_count, read_count;

    wire [COUNT_BITS-1:0] next_count = k_count == COUNT_MAX ? k_count : k_count + 1'b1;
    wire                  counts     = raises && raised_slot == k;

    always_ff @(posedge clk) begin
        begun <= 1'b1;
        if (counts && enable) k_count <= next_count;
        if (enable) under_way <= {under_way[0], take};
        after <= {after[0], draining};
        drains <= {drains[0], drain && draining};
        if (drain && draining) begin
            read_k       <= drain_slot == k && known;
            read_count   <= k_count;
            newer_slot   <= drain_slot;
            drained_slot <= newer_slot;
            // from then on it is 0
            if (drain_slot == k) begin
                k_count <= '0;
                known   <= 1'b1;
            end
        end
        if (!draining) read_k <= 1'b0;
        if (rst) begin
            known     <= 1'b0;
            under_way <= '0;
            drains    <= '0;
            read_k    <= 1'b0;
        end
    end

    always_comb begin
        assume (k < SLOTS && slot < SLOTS && drain_slot < SLOTS);
        if (!begun) assume (rst);
        // the encoder drains while no slot is on its way, each slot once, and no event is counted in
        // the two clocks behind it
        if (draining) assume (enable && !take && under_way == 0);
        if (after != 0) assume (enable && !take);
        if (take && slot == k) assume (known);
        if (drain && draining && drains != 0) assume (drain_slot != newer_slot);
        if (drain && draining && drains == 2'b11) assume (drain_slot != drained_slot);
    end

    always_comb begin
        if (begun && !rst) begin
            if (counts) assert (raised == next_count);
            assert (raises == under_way[1]);
            if (known) assert (k_count <= COUNT_MAX);
            if (read_k && draining) assert (drained == read_count && read_slot == k);
        end
    end
endmodule
