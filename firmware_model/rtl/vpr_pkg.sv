// Sizes and widths of the core, in one place. `edge-vpr hardware` and `edge-vpr golden --rtl` write
// this file anew with the values of a design in its first part; the second part follows from it.
//
// Each module names what it takes from here in its header. The installed tools have no better
// common form: yosys 0.23 neither reads `import` nor a package that refers to another one, and
// Icarus Verilog 11 no parameter whose type is a struct of a package.
package vpr_pkg;
    // The design: its keys, in their order, and then numbers that they give

    localparam int           WIDTH          = 2;      // of the sensor, in pixels
    localparam int           HEIGHT         = 2;
    localparam int           PIXELS         = 1;      // that are selected
    localparam int           CODE_BITS      = 1;
    localparam logic [63:0]  TAU_US         = 64'd1;
    localparam logic [31:0]  WINDOW_EVENTS  = 32'd1;
    localparam int           TIMESTAMP_BITS = 32;
    localparam int           PLACES         = 1;
    localparam int           LENGTH         = 1;      // windows of a sequence; 1 with the filter
    localparam int           GAINS          = 1;      // of the camera, of the filter: 1 or 7
    localparam logic [6:0]   RESTART        = 7'd0;   // cost
    localparam int           LANES          = 1;      // codes that are compared in a clock
    localparam int           EXCLUSION      = 0;      // places on each side of the best's zone
    localparam logic [8:0]   TRUST          = 9'd0;   // below which a match is not trusted
    localparam logic [31:0]  LARGEST_SUM    = 32'hFFFFFFFF;  // of a sequence that is accepted
    localparam int           LOOKUP_DEPTH   = 2;      // entries of the pixel look-up
    localparam bit           BY_TIME        = 1'd1;   // windows of TAU_US; else of WINDOW_EVENTS
    localparam int           COUNT_MAX      = 1;      // at which a counter saturates
    localparam bit           CONTRAST       = 1'd0;   // contrast codes; else counts
    localparam bit           FILTER         = 1'd0;   // the place filter; else sequences
    localparam int           STEPS          = 5;      // of 0, 1 ... places that have a cost
    // the table of their costs, 19 rows of 7 bits each, see vpr_step_costs
    localparam logic [930:0] STEP_COSTS     = 931'h0;
    localparam int           REACH          = 0;      // places on each side of the best that may be told
    // verilator lint_off UNUSEDPARAM
    localparam logic [31:0]  DESIGN_CRC     = 32'h0;  // of the design's file; for vpr_axi_lite
    // verilator lint_on UNUSEDPARAM

    // What follows from it

    // bits of an index of `n` things, and of the integers from 0 to `highest`: at least one
    function automatic integer index_bits(input integer n);
        index_bits = n > 1 ? $clog2(n) : 1;
    endfunction
    function automatic integer width_of(input logic [63:0] highest);
        width_of = highest == 0 ? 1 : $clog2(highest + 1);
    endfunction

    localparam int SLOTS = PIXELS;                       // counters, and codes of a descriptor
    localparam int WORDS = (SLOTS + LANES - 1) / LANES;  // of a descriptor
    localparam int SUMS  = GAINS > 1 ? 3 : 1;            // of newest windows: of 1, 2 and 4

    // events: their words, the pixel look-up, counters
    localparam int EVENT_TIME_BITS   = TIMESTAMP_BITS <= 32 ? 32 : 64;
    localparam int EVENT_BITS        = EVENT_TIME_BITS + 32;
    localparam int COLUMN_BITS       = index_bits(WIDTH);
    localparam int ROW_BITS          = index_bits(HEIGHT);
    localparam int ADDRESS_BITS      = index_bits(LOOKUP_DEPTH);
    localparam int OWNER_BITS        = index_bits(HEIGHT + 1);  // a value more: of no row
    localparam int SLOT_BITS         = index_bits(SLOTS);
    localparam int COUNT_BITS        = index_bits(COUNT_MAX + 1);
    localparam int WINDOW_COUNT_BITS = width_of(64'(WINDOW_EVENTS));
    localparam int SEEN_BITS         = SLOT_BITS + COUNT_BITS + 1;

    // descriptors
    localparam int LEVEL_BITS = 12;              // of contrast codes: the logarithm of COUNT_MAX is 2560
    localparam int MEAN_BITS  = LEVEL_BITS + 8;
    localparam int WORD_BITS  = LANES * CODE_BITS;

    // activity: events of a window, and their mean number times 256
    localparam bit PAUSES             = CONTRAST || FILTER;  // windows may pause
    localparam int WINDOW_EVENTS_BITS = 23;
    localparam int ACTIVITY_BITS      = WINDOW_EVENTS_BITS + 8;

    // distances, what the search compares (sums of sequences, or metrics), and acceptance
    localparam logic [63:0] CODE_MAX = (64'd1 << CODE_BITS) - 64'd1;

    localparam int PLACE_BITS    = index_bits(PLACES);
    localparam int SAD_BITS      = CODE_BITS + $clog2(LANES);
    localparam int DISTANCE_BITS = width_of(CODE_MAX * 64'(SLOTS));
    localparam int METRIC_BITS   = 7;
    localparam int SUM_BITS      =
        FILTER ? METRIC_BITS : width_of(CODE_MAX * 64'(SLOTS) * 64'(LENGTH));

    // the place filter
    localparam int PLACE_BIAS_BITS     = 8;  // of what is added to the distance of a place
    localparam int BIASED_BITS         = FILTER
        ? width_of((64'd1 << DISTANCE_BITS) + (64'd1 << PLACE_BIAS_BITS) - 64'd2) : DISTANCE_BITS;
    localparam int DISTANCE_TOTAL_BITS = width_of(((64'd1 << BIASED_BITS) - 64'd1) * 64'(PLACES));
    localparam int RECIPROCAL_BITS     = 17;
    localparam int EVIDENCE_BITS       = 8;
    // largest evidence against a match that counts, and largest margin: 23. So chosen that what is
    // above it has all bits from RESIDUAL_LOW on, or a bit beyond RESIDUAL_BITS
    localparam int RESIDUAL_BITS       = 5;
    localparam int RESIDUAL_LOW        = 3;
    localparam int RESIDUAL_TOP        = (1 << RESIDUAL_BITS) - (1 << RESIDUAL_LOW) - 1;
    localparam int TRUST_BITS          = 9;
    localparam int COST_BITS           = 7;  // of a step

    // window, place, sum, has_second, second, second_sum, ties, accepted, trust
    localparam int MATCH_BITS =
        32 + 3 * PLACE_BITS + 2 * SUM_BITS + 2 + (FILTER ? TRUST_BITS : 0);

    // for testbenches: more clocks than a match takes, of sequences and of the filter, whose first window
    // has a third pass over the places, and with several gains, which pass over them with each; a match
    // that takes longer is missing in the records
    // verilator lint_off UNUSEDPARAM
    localparam int MATCH_CLOCKS = SUMS * (500 + 2 * SLOTS) + 3 * PLACES * (WORDS + LENGTH)
                                  + 10 * (GAINS - 1) * (PLACES + 1);
    // verilator lint_on UNUSEDPARAM
endpackage
