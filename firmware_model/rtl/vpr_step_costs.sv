// Costs of steps of 0 to 4 places to a place, or of 0 to 6 places at half windows, in quarters, by
// the activity of the window less that of the place that is reached, in sixteenths of an octave: a
// row of the table for each half octave from -6 to +3, to which the difference is rounded and
// limited; the first row where the robot stands. `of_place_o` is the activity of the place, a clock
// behind `place_i`.
//
// `place_i` stands for two clocks at least. `costs_o` are those of a place that came with an edge at
// the third edge behind it: its activity, the difference, and the row are a clock each. They stay
// for as many clocks as the place. No cost is above RESTART.
module vpr_step_costs #(
    localparam int         PLACES     = vpr_pkg::PLACES,
    localparam int         PLACE_BITS = vpr_pkg::PLACE_BITS,
    localparam int         STEPS      = vpr_pkg::STEPS,
    // row by row, from -6 octaves on, each of steps of 0, 1 ... places, from the lowest bits on
    localparam logic [930:0] STEP_COSTS = vpr_pkg::STEP_COSTS,
    localparam logic [6:0] RESTART    = vpr_pkg::RESTART,
    localparam int         COST_BITS  = vpr_pkg::COST_BITS,
    parameter  bit         LOADABLE   = 0
) (
    input  logic                       clk_i,
    input  logic                       load_i,  // see vpr_rom
    input  logic [19:0]                load_address_i,
    input  logic [31:0]                load_word_i,
    input  logic [9:0]                 activity_inverse_i,
    input  logic                       stands_i,
    input  logic [PLACE_BITS-1:0]      place_i,
    output logic [7:0]                 of_place_o,
    output logic [STEPS*COST_BITS-1:0] costs_o
);
    localparam int ROWS            = 19;
    localparam int DIFFERENCE_BITS = 6;

    // The address is the difference in quarters of an octave, of 6 bits with sign
    (* ram_style = "block" *)
    logic [STEPS*COST_BITS-1:0] rows[0:(1<<DIFFERENCE_BITS)-1];

    function automatic [COST_BITS-1:0] cost_at(input integer address, input integer step);
        integer quarters, row;
        quarters = address < 32 ? address : address - 64;
        // half octaves, rounded, from -12 to 6
        row      = quarters < -24 ? 0 : quarters > 11 ? ROWS - 1 : (quarters + 25) / 2;
        cost_at  = STEP_COSTS[COST_BITS*(STEPS*row+step)+:COST_BITS];
        if (cost_at > RESTART) cost_at = RESTART;
    endfunction

    function automatic [STEPS*COST_BITS-1:0] row_at(input integer address);
        integer step;
        for (step = 0; step < STEPS; step = step + 1)
            row_at[COST_BITS*step+:COST_BITS] = cost_at(address, step);
    endfunction

    integer at;
    initial
        for (at = 0; at < (1 << DIFFERENCE_BITS); at = at + 1)
            rows[at] = row_at(at);

    logic [DIFFERENCE_BITS-1:0] difference_q;

    vpr_rom #(
        .DEPTH(PLACES), .BITS(8), .ADDRESS_BITS(PLACE_BITS), .FILE("place_activity.mem"),
        .LOADABLE(LOADABLE), .STYLE("block")
    ) place_activity (
        .clk_i(clk_i), .enable_i(1'b1), .address_i(place_i), .word_o(of_place_o),
        .load_i(load_i), .load_address_i(load_address_i), .load_word_i(load_word_i)
    );

    // the place's less the window's, less 1: the inverse of the window's less the place's
    wire [9:0] less = {{2{of_place_o[7]}}, of_place_o} + activity_inverse_i;
    wire       fits = less[8:7] == {2{less[9]}};

    always_ff @(posedge clk_i) begin
        // beyond 8 octaves it is as far as 6 bits can tell, which is behind the last row
        difference_q <= stands_i ? {1'b1, {(DIFFERENCE_BITS - 1){1'b0}}}
                      : fits ? ~less[7:2] : {!less[9], {(DIFFERENCE_BITS - 1){less[9]}}};
        costs_o      <= rows[difference_q];
    end

    wire unused = &{1'b0, less};
endmodule
