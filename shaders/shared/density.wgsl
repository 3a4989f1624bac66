// Tests for oversampling and undersampling (section 3.3 of the paper) with the random bias of
// Witkin and Heckbert: the relative excess or deficit of energy, multiplied by a random number in
// [0, 1), must exceed the threshold.
//
// Twin: `delete`, `insert` in stages/particles/src/density.rs

fn is_oversampled(energy: f32, i: u32) -> bool {
    let excess = energy / parameters.ideal_energy - 1.0;
    return excess > parameters.delete_above - 1.0
        && random_uniform(stream_of(0u), i) * excess > parameters.delete_above - 1.0;
}

fn is_undersampled(energy: f32, i: u32) -> bool {
    let lack = 1.0 - energy / parameters.ideal_energy;
    return lack > 1.0 - parameters.add_below && random_uniform(stream_of(1u), i) * lack > 1.0 - parameters.add_below;
}
