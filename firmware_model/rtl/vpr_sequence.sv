// Sums along the diagonal: the distances of the last LENGTH windows, one place back for each window
// back. They are kept in a ring of LENGTH rows of PLACES distances in a memory with one port, which
// is written in the clock of a distance and read in the LENGTH - 1 clocks after it.
//
// `start_i` begins a window. A place filter takes the same distances and gives the same kind of sums:
// it stands beside this unit. `sum_o` and `place_o` stay for the clock after `sum_valid_o`; there is a
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
    input  logic                     clk_i,
    input  logic                     rst_i,
    input  logic                     start_i,
    input  logic                     distance_valid_i,
    input  logic [DISTANCE_BITS-1:0] distance_i,
    output logic                     sum_valid_o,
    output logic                     sum_complete_o,
    output logic                     sum_last_o,
    output logic [PLACE_BITS-1:0]    place_o,
    output logic [SUM_BITS-1:0] sum_o
);
    localparam int LENGTH_BITS = $clog2(LENGTH + 1);

    logic [SUM_BITS-1:0]    sum_inverse_q;  // as the search compares it
    assign sum_o = ~sum_inverse_q;

    logic [LENGTH_BITS-1:0] seen_q;
    logic                   sum_next;  // with the next clock there is a sum

    wire seen_all = seen_q == LENGTH_BITS'(LENGTH);

    always_ff @(posedge clk_i) begin
        if (start_i && !seen_all) seen_q <= seen_q + 1'b1;
        if (start_i) place_o <= '1;
        else if (sum_next) place_o <= place_o + 1'b1;
        sum_valid_o <= sum_next;
        if (rst_i) begin
            seen_q      <= '0;
            sum_valid_o <= 1'b0;
        end
    end

    assign sum_last_o = place_o == PLACE_BITS'(PLACES - 1);

    generate
        if (LENGTH == 1) begin : g_single
            assign sum_next     = distance_valid_i;
            assign sum_complete_o = seen_all;
            always_ff @(posedge clk_i) if (distance_valid_i) sum_inverse_q <= ~(SUM_BITS'(distance_i));
        end else begin : g_diagonal
            localparam int ADDRESS_BITS = $clog2(LENGTH * PLACES);
            localparam int NEWEST_BITS  = $clog2(LENGTH);
            // one row and one place back; from the first row, to the last
            localparam logic [ADDRESS_BITS-1:0] BACK    = ADDRESS_BITS'(-(PLACES + 1));
            localparam logic [ADDRESS_BITS-1:0] WRAPPED = ADDRESS_BITS'((LENGTH - 1) * PLACES - 1);

            logic [NEWEST_BITS-1:0]   newest_q, row_q;
            logic [ADDRESS_BITS-1:0]  write_address_q, read_address_q;
            logic [LENGTH_BITS-1:0]   terms_q;
            logic                     first_valid, term_valid, term_last;
            logic [DISTANCE_BITS-1:0] first, term, past;
            logic [SUM_BITS-1:0]      partial_q;
            // a term comes from the memory
            logic                     past_valid_q, past_last_q;

            wire                     newest_last = newest_q == NEWEST_BITS'(LENGTH - 1);
            wire                     reading     = terms_q != 0;
            wire [NEWEST_BITS-1:0]   here_row    = distance_valid_i ? newest_q : row_q;
            wire [ADDRESS_BITS-1:0]  here        = distance_valid_i ? write_address_q : read_address_q;
            wire [ADDRESS_BITS-1:0]  back        = here_row == 0 ? WRAPPED : BACK;
            wire [SUM_BITS-1:0] added       = partial_q + SUM_BITS'(term);

            assign sum_next     = term_valid && term_last;
            assign sum_complete_o = seen_all && place_o >= PLACE_BITS'(LENGTH - 1);

            always_ff @(posedge clk_i) begin
                if (start_i) newest_q <= newest_last ? '0 : newest_q + 1'b1;
                // a row begins where the one before it ended
                if (start_i && newest_last) write_address_q <= '0;
                else if (distance_valid_i) write_address_q <= write_address_q + 1'b1;
                if (distance_valid_i) terms_q <= LENGTH_BITS'(LENGTH - 1);
                else if (reading) terms_q <= terms_q - 1'b1;
                row_q          <= here_row == 0 ? NEWEST_BITS'(LENGTH - 1) : here_row - 1'b1;
                read_address_q <= here + back;
                past_valid_q   <= reading;
                past_last_q    <= terms_q == 1;
                if (first_valid) partial_q <= SUM_BITS'(first);
                else if (term_valid) partial_q <= added;
                if (sum_next) sum_inverse_q <= ~added;
                if (rst_i) begin
                    newest_q     <= NEWEST_BITS'(LENGTH - 1);
                    terms_q      <= '0;
                    past_valid_q <= 1'b0;
                end
            end

            if (SLOW_BLOCKS) begin : g_registers
                always_ff @(posedge clk_i) begin
                    first_valid <= distance_valid_i && !rst_i;
                    if (distance_valid_i) first <= distance_i;
                    term_valid <= past_valid_q && !rst_i;
                    term_last  <= past_last_q;
                    term       <= past;
                end
            end else begin : g_direct
                assign first_valid = distance_valid_i;
                assign first       = distance_i;
                assign term_valid  = past_valid_q;
                assign term_last   = past_last_q;
                assign term        = past;
            end

            vpr_ram_single #(
                .DEPTH(LENGTH * PLACES), .BITS(DISTANCE_BITS), .ADDRESS_BITS(ADDRESS_BITS),
                .STYLE(MEMORY_STYLE)
            ) history (
                .clk_i(clk_i), .write_i(distance_valid_i), .address_i(here), .write_word_i(distance_i),
                .read_word_o(past)
            );
        end
    endgenerate
endmodule
