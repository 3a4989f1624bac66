// Totals of a pass, summed in a fixed order.

struct Totals {
    energy: f32,
    // Maximum displacement of a particle since the lists were built, in units of its h.
    longest_way: f32,
    moved: u32,
    tries: u32,
    defects: u32,
    // Total length of all lists, and length of the longest list.
    listed: u32,
    longest_list: u32,
}

var<workgroup> lane_totals: array<Totals, SUM_GROUP>;

fn add_totals(a: Totals, b: Totals) -> Totals {
    return Totals(
        a.energy + b.energy,
        max(a.longest_way, b.longest_way),
        a.moved + b.moved,
        a.tries + b.tries,
        a.defects + b.defects,
        a.listed + b.listed,
        max(a.longest_list, b.longest_list),
    );
}

// Returns the total over a workgroup of SUM_GROUP invocations. The result is valid only in lane 0.
fn total_of_group(own: Totals, lane: u32) -> Totals {
    lane_totals[lane] = own;
    workgroupBarrier();
    for (var step = SUM_GROUP / 2u; step > 0u; step >>= 1u) {
        if lane < step {
            lane_totals[lane] = add_totals(lane_totals[lane], lane_totals[lane + step]);
        }
        workgroupBarrier();
    }
    return lane_totals[0];
}
