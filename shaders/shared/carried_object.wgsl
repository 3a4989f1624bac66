// In a single-object run, normal.w stores the damping of the particle. Two particles interact if
// their normals agree.

fn damping_of(carried: f32) -> f32 {
    return carried;
}

fn with_damping(carried: f32, damping: f32) -> f32 {
    return damping;
}

fn is_held(carried: f32) -> bool {
    return false;
}

fn see_each_other(a: vec4<f32>, b: vec4<f32>) -> bool {
    return dot(a.xyz, b.xyz) > parameters.normal_agreement;
}
