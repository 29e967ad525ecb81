// Sums along the diagonal: the distances of the last LENGTH windows, one place back for each window
// back. They are kept in a ring of LENGTH rows of PLACES distances in a memory with one port, which
// is written in the clock of a distance and read in the LENGTH - 1 clocks after it.
//
// `start` begins a window. A place filter takes the same distances and gives the same kind of sums:
// it stands beside this unit. `sum` and `place` stay for the clock after `sum_valid`; there is a
// sum for every place, but those that no sequence ends at are not `complete`.
module vpr_sequence #(
    localparam int PLACES        = vpr_pkg::PLACES,
    localparam int LENGTH        = vpr_pkg::LENGTH,
    localparam int PLACE_BITS    = vpr_pkg::PLACE_BITS,
    localparam int DISTANCE_BITS = vpr_pkg::DISTANCE_BITS,
    localparam int SUM_BITS      = vpr_pkg::SUM_BITS,
    parameter      MEMORY_STYLE  = "auto",
    parameter  bit SLOW_BLOCKS   = 0  // a register behind the memory, see vpr_core
) (
    input  logic                     clk,
    input  logic                     rst,
    input  logic                     start,
    input  logic                     distance_valid,
    input  logic [DISTANCE_BITS-1:0] distance,
    output logic                     sum_valid,
    output logic                     sum_complete,
    output logic                     sum_last,
    output logic [PLACE_BITS-1:0]    place,
    output logic [SUM_BITS-1:0] sum
);
    localparam int LENGTH_BITS = $clog2(LENGTH + 1);

    logic [SUM_BITS-1:0]    sum_inverse;  // as the search compares it
    assign sum = ~sum_inverse;

    logic [LENGTH_BITS-1:0] seen;
    logic                   sum_next;  // with the next clock there is a sum

    wire seen_all = seen == LENGTH_BITS'(LENGTH);

    always_ff @(posedge clk) begin
        if (start && !seen_all) seen <= seen + 1'b1;
        if (start) place <= '1;
        else if (sum_next) place <= place + 1'b1;
        sum_valid <= sum_next;
        if (rst) begin
            seen      <= '0;
            sum_valid <= 1'b0;
        end
    end

    assign sum_last = place == PLACE_BITS'(PLACES - 1);

    generate
        if (LENGTH == 1) begin : g_single
            assign sum_next     = distance_valid;
            assign sum_complete = seen_all;
            always_ff @(posedge clk) if (distance_valid) sum_inverse <= ~(SUM_BITS'(distance));
        end else begin : g_diagonal
            localparam int ADDRESS_BITS = $clog2(LENGTH * PLACES);
            localparam int ROW_BITS     = $clog2(LENGTH);
            // one row and one place back; from the first row, to the last
            localparam logic [ADDRESS_BITS-1:0] BACK    = ADDRESS_BITS'(-(PLACES + 1));
            localparam logic [ADDRESS_BITS-1:0] WRAPPED = ADDRESS_BITS'((LENGTH - 1) * PLACES - 1);

            logic [ROW_BITS-1:0]      newest, row;
            logic [ADDRESS_BITS-1:0]  write_address, read_address;
            logic [LENGTH_BITS-1:0]   terms;
            logic                     first_valid, term_valid, term_last;
            logic [DISTANCE_BITS-1:0] first, term, past;
            logic [SUM_BITS-1:0]      partial;
            // a term comes from the memory
            logic                     past_valid, past_last;

            wire                     newest_last = newest == ROW_BITS'(LENGTH - 1);
            wire                     reading     = terms != 0;
            wire [ROW_BITS-1:0]      here_row    = distance_valid ? newest : row;
            wire [ADDRESS_BITS-1:0]  here        = distance_valid ? write_address : read_address;
            wire [ADDRESS_BITS-1:0]  back        = here_row == 0 ? WRAPPED : BACK;
            wire [SUM_BITS-1:0] added       = partial + SUM_BITS'(term);

            assign sum_next     = term_valid && term_last;
            assign sum_complete = seen_all && place >= PLACE_BITS'(LENGTH - 1);

            always_ff @(posedge clk) begin
                if (start) newest <= newest_last ? '0 : newest + 1'b1;
                // a row begins where the one before it ended
                if (start && newest_last) write_address <= '0;
                else if (distance_valid) write_address <= write_address + 1'b1;
                if (distance_valid) terms <= LENGTH_BITS'(LENGTH - 1);
                else if (reading) terms <= terms - 1'b1;
                row          <= here_row == 0 ? ROW_BITS'(LENGTH - 1) : here_row - 1'b1;
                read_address <= here + back;
                past_valid   <= reading;
                past_last    <= terms == 1;
                if (first_valid) partial <= SUM_BITS'(first);
                else if (term_valid) partial <= added;
                if (sum_next) sum_inverse <= ~added;
                if (rst) begin
                    newest     <= ROW_BITS'(LENGTH - 1);
                    terms      <= '0;
                    past_valid <= 1'b0;
                end
            end

            if (SLOW_BLOCKS) begin : g_registers
                always_ff @(posedge clk) begin
                    first_valid <= distance_valid && !rst;
                    if (distance_valid) first <= distance;
                    term_valid <= past_valid && !rst;
                    term_last  <= past_last;
                    term       <= past;
                end
            end else begin : g_direct
                assign first_valid = distance_valid;
                assign first       = distance;
                assign term_valid  = past_valid;
                assign term_last   = past_last;
                assign term        = past;
            end

            vpr_ram_single #(
                .DEPTH(LENGTH * PLACES), .BITS(DISTANCE_BITS), .ADDRESS_BITS(ADDRESS_BITS),
                .STYLE(MEMORY_STYLE)
            ) history (
                .clk(clk), .write(distance_valid), .address(here), .write_word(distance),
                .read_word(past)
            );
        end
    endgenerate
endmodule
