// Totals of a pass, summed in a fixed order.

struct Totals {
    energy: f32,
    // Maximum distance that a particle has moved since the lists were made, in units of its h.
    longest_way: f32,
    moved: u32,
    tries: u32,
    defects: u32,
    // Members of all lists, and of the longest one.
    listed: u32,
    longest_list: u32,
}

var<workgroup> partial: array<Totals, WIDE>;

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

// The total over a workgroup of WIDE, in lane 0.
fn total_of_group(own: Totals, lane: u32) -> Totals {
    partial[lane] = own;
    workgroupBarrier();
    for (var step = WIDE / 2u; step > 0u; step >>= 1u) {
        if lane < step {
            partial[lane] = add_totals(partial[lane], partial[lane + step]);
        }
        workgroupBarrier();
    }
    return partial[0];
}
