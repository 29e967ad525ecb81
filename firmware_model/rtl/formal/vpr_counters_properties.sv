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
    input logic                 clearing,
    input logic                 swap,
    input logic                 enable,
    input logic                 take,
    input logic [SLOT_BITS-1:0] slot,
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
        .clk(clk), .rst(rst), .clearing(clearing), .swap(swap), .enable(enable), .take(take),
        .slot(slot), .raises(raises), .raised_slot(raised_slot), .raised(raised), .drain(drain),
        .drain_slot(drain_slot), .drained(drained), .clear(clear), .clear_slot(clear_slot)
    );

    // counts of `k` in the window that is open and in the one before it; slots that are on their way
    logic                  begun = 1'b0;
    logic                  open_known, ended_known, reading, read_k, last_enable;
    logic [1:0]            under_way;
    logic [COUNT_BITS-1:0] open_count, ended_count, read_count;

    wire [COUNT_BITS-1:0] next_count = open_count == COUNT_MAX ? open_count : open_count + 1'b1;
    wire                  clears     = clear && clear_slot == k;
    wire                  counts     = raises && raised_slot == k;

    always_ff @(posedge clk) begin
        begun <= 1'b1;
        if (counts && enable) open_count <= next_count;
        if (clears) begin
            ended_count <= '0;
            ended_known <= 1'b1;
        end
        if (clears && clearing) begin
            open_count <= '0;
            open_known <= 1'b1;
        end
        if (swap) begin
            open_count  <= ended_count;
            ended_count <= open_count;
            open_known  <= ended_known;
            ended_known <= open_known;
        end
        if (enable) under_way <= {under_way[0], take};
        if (drain) begin
            read_k     <= drain_slot == k && ended_known;
            read_count <= ended_count;
        end
        if (swap) read_k <= 1'b0;
        if (rst) begin
            open_known  <= 1'b0;
            ended_known <= 1'b0;
            under_way   <= '0;
            read_k      <= 1'b0;
        end
    end

    always_comb begin
        assume (k < SLOTS && slot < SLOTS && drain_slot < SLOTS && clear_slot < SLOTS);
        if (!begun) assume (rst);
        // the encoder clears both banks first, and a slot after it has read it
        if (clearing) assume (!take && under_way == 0 && !swap);
        if (take && slot == k) assume (open_known);
        if (swap) assume (!take && under_way == 0 && !drain && !clear);
        if (drain && clear) assume (drain_slot != clear_slot);
    end

    always_comb begin
        if (begun && !rst) begin
            if (counts) assert (raised == next_count);
            assert (raises == under_way[1]);
            if (open_known) assert (open_count <= COUNT_MAX);
            if (read_k && !clearing) assert (drained == read_count);
        end
    end
endmodule
