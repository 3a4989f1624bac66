// Totals of a pass, added up in a fixed order.

struct Totals {
    energy: f32,
    // Longest way of a particle since the lists were made, over its h.
    longest: f32,
    moved: u32,
    tries: u32,
    defects: u32,
}

var<workgroup> partial: array<Totals, WIDE>;

fn add_totals(a: Totals, b: Totals) -> Totals {
    return Totals(a.energy + b.energy, max(a.longest, b.longest), a.moved + b.moved, a.tries + b.tries, a.defects + b.defects);
}

// The sum over a workgroup of WIDE, in lane 0.
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
