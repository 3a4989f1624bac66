// Two orthonormal directions that span the tangent plane.
//
// Twin: `TangentPlane` in stages/particles/src/neighbourhood.rs

struct Plane {
    u: vec3<f32>,
    v: vec3<f32>,
}

// Returns the tangent plane, computed by the method of Duff et al. (2017) as in glam's
// any_orthonormal_vector.
fn tangent_plane(normal: vec3<f32>) -> Plane {
    let sign = select(-1.0, 1.0, normal.z >= 0.0);
    let a = -1.0 / (sign + normal.z);
    let b = normal.x * normal.y * a;
    let u = vec3(b, sign + normal.y * normal.y * a, -normal.y);
    return Plane(u, cross(normal, u));
}
