// What vpr_counters must count, for any slots at any times: properties for the model checker pdr.
// One slot `k`, chosen freely and kept, stands for all.
module vpr_counters_properties #(
    parameter SLOTS      = 3,
    parameter SLOT_BITS  = 2,
    parameter COUNT_BITS = 2,
    parameter COUNT_MAX  = 2
) (
    input logic                 clk,
    input logic                 rst,
    input logic                 enable,
    input logic                 take,
    input logic [SLOT_BITS-1:0] slot,
    input logic                 draining,
    input logic                 drain,
    input logic [SLOT_BITS-1:0] drain_slot,
    input logic                 clear,
    input logic [SLOT_BITS-1:0] clear_slot
);
    (* anyconst *) logic [SLOT_BITS-1:0] k;

    logic                  raises;
    logic [SLOT_BITS-1:0]  raised_slot;
    logic [COUNT_BITS-1:0] raised, drained;

    vpr_counters #(
        .SLOTS(SLOTS), .SLOT_BITS(SLOT_BITS), .COUNT_BITS(COUNT_BITS), .COUNT_MAX(COUNT_MAX)
    ) counters (
        .clk(clk), .rst(rst), .enable(enable), .take(take),
        .slot(slot), .raises(raises), .raised_slot(raised_slot), .raised(raised), .draining(draining),
        .drain(drain), .drain_slot(drain_slot), .drained(drained), .clear(clear), .clear_slot(clear_slot)
    );

    // the count of `k`, which is known once it was cleared; and slots that are on their way
    logic                  begun = 1'b0;
    logic                  known, read_k;
    logic [1:0]            under_way;
    logic [COUNT_BITS-1:0] k_count, read_count;

    wire [COUNT_BITS-1:0] next_count = k_count == COUNT_MAX ? k_count : k_count + 1'b1;
    wire                  counts     = raises && raised_slot == k;

    always_ff @(posedge clk) begin
        begun <= 1'b1;
        if (counts && enable) k_count <= next_count;
        if (clear && clear_slot == k) begin
            k_count <= '0;
            known   <= 1'b1;
        end
        if (enable) under_way <= {under_way[0], take};
        if (drain && draining) begin
            read_k     <= drain_slot == k && known;
            read_count <= k_count;
        end
        if (!draining) read_k <= 1'b0;
        if (rst) begin
            known     <= 1'b0;
            under_way <= '0;
            read_k    <= 1'b0;
        end
    end

    always_comb begin
        assume (k < SLOTS && slot < SLOTS && drain_slot < SLOTS && clear_slot < SLOTS);
        if (!begun) assume (rst);
        // the encoder drains while no slot is on its way, and clears a slot after it has read it
        if (draining) assume (!take && under_way == 0);
        else assume (!clear);
        if (take && slot == k) assume (known);
        if (drain && clear) assume (drain_slot != clear_slot);
    end

    always_comb begin
        if (begun && !rst) begin
            if (counts) assert (raised == next_count);
            assert (raises == under_way[1]);
            if (known) assert (k_count <= COUNT_MAX);
            if (read_k && draining) assert (drained == read_count);
        end
    end
endmodule
