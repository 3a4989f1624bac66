// Totals of a pass, step 2: a single workgroup sums the totals of all blocks and writes the words
// that the host reads.

@group(0) @binding(6) var<storage, read> block_totals: array<Totals>;
// The words are documented in stages/particles/src/gpu/constants.rs.
@group(0) @binding(15) var<storage, read_write> words: array<u32>;

@compute @workgroup_size(SUM_GROUP)
fn sum_total(@builtin(local_invocation_index) lane: u32) {
    let blocks = (now.count + SUM_BLOCK - 1u) / SUM_BLOCK;
    var own = Totals();
    for (var block = lane; block < blocks; block += SUM_GROUP) {
        own = add_totals(own, block_totals[block]);
    }
    let total = total_of_group(own, lane);
    if lane == 0u {
        words[WORD_ENERGY] = bitcast<u32>(total.energy);
        words[WORD_MOVED] = total.moved;
        words[WORD_TRIES] = total.tries;
        words[WORD_LONGEST_WAY] = bitcast<u32>(total.longest_way);
        words[WORD_LISTED] = total.listed;
        words[WORD_LONGEST_LIST] = total.longest_list;
        words[WORD_COUNT] = now.count;
        words[WORD_KEPT] = now.count;
        words[WORD_DEFECTS] = total.defects;
    }
}
