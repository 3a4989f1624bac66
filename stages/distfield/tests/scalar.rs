//! Tests scalar volumes against analytic solutions: distance, zero set, slope, border, and voxels
//! equal to the iso value.

mod support;

use glam::DVec3;
use isoparticles_distfield::{Border, Inside, Keep, Redistanced, ScalarOptions, from_scalar};
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::spline::CubicSpline;
use isoparticles_field::topology::FieldTopology;
use isoparticles_stage::cli::Context;
use isoparticles_volume::Image;
use support::{directions, positions, sampled, topology, volume};

const MARGIN: usize = 4;

fn extract(image: &Image<f32>, iso: f64, border: Border) -> Redistanced {
    let options =
        ScalarOptions { inside: Inside::Above, border, margin: MARGIN, cut: [[false; 2]; 3], keep: Keep::All };
    from_scalar(image.clone(), iso, &options, &Context::silent("distfield")).expect("a surface")
}

/// Returns the maximum errors of F, in voxels: within 2.5 voxels of the surface, and over the whole
/// grid. `distance` is the true distance in the grid frame of the input.
fn distance_errors(result: &Redistanced, distance: impl Fn(DVec3) -> f64) -> (f64, f64) {
    let geometry = &result.field.geometry;
    let shift = geometry.spacing * MARGIN as f64;
    let voxel = geometry.mean_spacing();
    positions(geometry).zip(&result.field.data).fold((0.0f64, 0.0f64), |(band, all), (p, &f)| {
        let truth = distance(p - shift);
        let error = (f64::from(f) - truth).abs() / voxel;
        (if truth.abs() < 2.5 * voxel { band.max(error) } else { band }, all.max(error))
    })
}

/// Returns options for an object that is closed at the border.
fn capped(inside: Inside, keep: Keep) -> ScalarOptions {
    ScalarOptions { inside, border: Border::Cap, margin: MARGIN, cut: [[false; 2]; 3], keep }
}

#[test]
fn a_ball_has_exact_distances_and_slope_one() {
    let spacing = DVec3::new(0.8, 1.0, 0.9);
    let centre = DVec3::new(12.3, 12.1, 12.6);
    // a quadratic function, which the spline reproduces, but which is not a distance
    let image = sampled([31, 25, 29], spacing, |p| (100.0 - (p - centre).length_squared()) as f32);
    let result = extract(&image, 36.0, Border::Cap);
    let (band, all) = distance_errors(&result, |p| p.distance(centre) - 8.0);
    println!("ball: band error {band:.5}, largest {all:.3} voxel, {:?}", result.shift);
    // measured maximum error anywhere: 0.010
    assert!(band < 0.002, "band error {band}");
    assert!(all < 0.02, "largest error {all}");
    assert!(result.shift.mean < 1e-3 && result.shift.p99 < 2e-3, "{:?}", result.shift);
    assert_eq!((result.parts_after.components, result.parts_after.cavities), (1, 0));
    let spline = CubicSpline::new(&result.field);
    for direction in directions(500) {
        for r in [6.0, 8.0, 9.5] {
            let p = centre + spacing * MARGIN as f64 + direction * r;
            let slope = spline.value_gradient(p).1.length();
            assert!((slope - 1.0).abs() < 0.02, "slope {slope} at r = {r}");
        }
    }
}

#[test]
fn an_ellipsoid_and_a_torus_have_exact_distances() {
    let centre = DVec3::new(16.2, 12.4, 10.3);
    let axes = DVec3::new(12.0, 8.0, 6.0);
    let ellipsoid = |p: DVec3| (1.0 - ((p - centre) / axes).length_squared()) as f32;
    let result = extract(&sampled([33, 26, 22], DVec3::ONE, ellipsoid), 0.0, Border::Cap);
    let (band, all) = distance_errors(&result, |p| ellipsoid_distance(p - centre, axes));
    println!("ellipsoid: band error {band:.5}, largest {all:.3} voxel");
    assert!(band < 0.005 && all < 0.02, "ellipsoid: band error {band}, largest {all}");
    assert!(result.shift.p99 < 0.004, "{:?}", result.shift);

    let centre = DVec3::new(16.3, 16.1, 9.2);
    let to_tube = move |p: DVec3| {
        let q = p - centre;
        (q.x.hypot(q.y) - 9.0).hypot(q.z)
    };
    let image = sampled([33, 33, 19], DVec3::ONE, |p| (20.0 - to_tube(p).powi(2)) as f32);
    let result = extract(&image, 4.0, Border::Cap);
    let (band, _) = distance_errors(&result, |p| {
        // nodes near the centre line of the tube are excluded because they are close to the medial
        // axis
        let d = to_tube(p) - 4.0;
        if d < -2.0 { f64::INFINITY } else { d }
    });
    // the measured error is 0.012, because the zero set of the spline through the input is not
    // exactly a torus
    assert!(band < 0.015, "torus: band error {band}");
    assert_eq!(topology(&result.field).components[0].genus, Some(1));
}

/// Returns the signed distance to an ellipsoid. Bisection finds the Lagrange multiplier of the
/// closest point.
fn ellipsoid_distance(p: DVec3, axes: DVec3) -> f64 {
    let q = p.abs().max(DVec3::splat(1e-9));
    let at = |t: f64| q * axes * axes / (axes * axes + DVec3::splat(t));
    let inside = (q / axes).length_squared() < 1.0;
    let (mut low, mut high) = (-axes.min_element().powi(2) + 1e-9, 1e5);
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if (at(middle) / axes).length_squared() > 1.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    let distance = q.distance(at(low));
    if inside { -distance } else { distance }
}

#[test]
fn a_gyroid_through_the_border_keeps_its_zero_set() {
    let f = |p: DVec3| {
        let q = p * 0.45;
        (q.x.sin() * q.y.cos() + q.y.sin() * q.z.cos() + q.z.sin() * q.x.cos()) as f32
    };
    for border in [Border::Cap, Border::Open] {
        let image = sampled([30, 30, 30], DVec3::ONE, f);
        let result = extract(&image, 0.0, border);
        // The measured mean and 99th percentile of the shift are 0.0029 and 0.030 voxel with the
        // cap, and 0.0019 and 0.034 voxel without it. The edges of the cap are rounded by half a
        // voxel, which no spline on this grid can represent. With the cap, the mean is 0.017 before
        // the fit, and lowest (0.0026) after 110 steps. After 640 steps, it is 0.018: F at the
        // samples is then 0.0003, but new surfaces appear between the samples. All of these shifts
        // occur within a voxel of the cap.
        assert!(result.shift.mean < 0.005 && result.shift.p99 < 0.05, "{border:?}: {:?}", result.shift);
        let inner = shift_within(&result, &image, 1.0);
        println!("gyroid, {border:?}: {:?}, {inner:?} 1.5 voxels from the border", result.shift);
        assert!(inner.0 < 0.001 && inner.1 < 0.004, "{border:?}: {inner:?}");
        assert_eq!(result.parts_before.components, result.parts_after.components);
        assert_eq!(topology(&result.field).is_closed_manifold(), border == Border::Cap);
    }
}

/// Returns the mean and the 99th percentile of the distance, in voxels, from the zero set of F to
/// the zero set of the image's spline. Only points at least `inset` voxels inside the outermost
/// voxel centres are included.
fn shift_within(result: &Redistanced, image: &Image<f32>, inset: f64) -> (f64, f64) {
    let (own, source) = (CubicSpline::new(&result.field), CubicSpline::new(image));
    let margin = image.geometry.spacing * MARGIN as f64;
    let (low, high) = (image.geometry.spacing * inset, image.geometry.upper_corner() - image.geometry.spacing * inset);
    let mut shifts: Vec<f64> = marching_cubes(&result.field, 0.0)
        .vertices
        .iter()
        .filter_map(|&v| own.project(v, 1.0, 1e-7))
        .map(|p| p - margin)
        .filter(|p| p.cmpgt(low).all() && p.cmplt(high).all())
        .map(|p| {
            let (value, gradient) = source.value_gradient(p);
            value.abs() / gradient.length() / image.geometry.mean_spacing()
        })
        .collect();
    shifts.sort_by(f64::total_cmp);
    assert!(shifts.len() > 1000);
    (shifts.iter().sum::<f64>() / shifts.len() as f64, shifts[(shifts.len() - 1) * 99 / 100])
}

#[test]
fn noise_does_not_move_the_zero_set() {
    let noisy = |p: DVec3| {
        let counter = (p.x + 100.0 * p.y + 10_000.0 * p.z) as u64;
        (9.0 - p.distance(DVec3::splat(15.2)) + 1.5 * (isoparticles_field::random::uniform(3, 0, counter) - 0.5)) as f32
    };
    let result = extract(&sampled([31, 31, 31], DVec3::ONE, noisy), 0.0, Border::Cap);
    assert!(result.shift.mean < 0.01 && result.shift.p99 < 0.05, "{:?}", result.shift);
    assert_eq!(result.parts_before.components, result.parts_after.components);
    assert_eq!(result.parts_before.cavities, result.parts_after.cavities);
}

#[test]
fn a_cylinder_is_closed_at_the_border() {
    let axis = DVec3::new(12.2, 11.7, 0.0);
    let radius = |p: DVec3| ((p - axis) * DVec3::new(1.0, 1.0, 0.0)).length();
    let image = sampled([25, 25, 20], DVec3::ONE, |p| (100.0 - radius(p).powi(2)) as f32);
    let result = extract(&image, 64.0, Border::Cap);
    let found = topology(&result.field);
    assert!(found.is_closed_manifold());
    assert_eq!(found.components.len(), 1);
    assert_eq!(found.components[0].genus, Some(0));
    // the expected volume is a cylinder of radius 6 and height 20 (the caps are half a voxel beyond
    // the outermost voxel centres) minus its fillets of radius 0.5
    let fillet = (1.0 - std::f64::consts::FRAC_PI_4) * 0.25 * 2.0 * std::f64::consts::PI * 6.0;
    let truth = std::f64::consts::PI * 36.0 * 20.0 - 2.0 * fillet;
    let found = volume(&result.field);
    assert!((found / truth - 1.0).abs() < 0.015, "volume {found}, should be {truth}");
    // between voxel centres, the lateral surface is unchanged
    let spline = CubicSpline::new(&result.field);
    for n in 0..200 {
        let angle = f64::from(n) * 0.1;
        let p = axis + 6.0 * DVec3::new(angle.cos(), angle.sin(), 0.0) + DVec3::Z * f64::from(n % 20);
        let f = spline.value(p + DVec3::splat(MARGIN as f64));
        assert!(f.abs() < 0.05, "F = {f} on the side at z = {}", p.z);
    }
    let cap = spline.value(axis + DVec3::new(0.0, 0.0, -0.5) + DVec3::splat(MARGIN as f64));
    assert!(cap.abs() < 1e-3, "F = {cap} on the cap");
}

#[test]
fn voxels_equal_to_the_iso_value_are_handled() {
    // integer values, many of them equal to the iso value
    let image = sampled([21, 21, 21], DVec3::ONE, |p| (20.0 - (p - DVec3::splat(10.0)).length()).round() as f32);
    assert!(image.data.iter().filter(|v| **v == 13.0).count() > 300);
    let result = extract(&image, 13.0, Border::Cap);
    let geometry = &result.field.geometry;
    let padded = |n: usize| geometry.linear(n % 21 + MARGIN, n / 21 % 21 + MARGIN, n / 441 + MARGIN);
    for (n, &value) in image.data.iter().enumerate() {
        let f = result.field.data[padded(n)];
        assert!(f.abs() >= 0.999e-3, "|F| = {f} at a node");
        assert_eq!(f < 0.0, value > 13.0, "value {value}, F = {f}");
    }
    assert!(topology(&result.field).is_closed_manifold());
    assert_eq!(result.parts_after.components, result.parts_before.components);
}

#[test]
fn the_low_side_is_the_complement() {
    let image = sampled([20, 20, 20], DVec3::ONE, |p| p.distance(DVec3::splat(9.3)) as f32);
    let options = capped(Inside::Below, Keep::All);
    let result = from_scalar(image.clone(), 6.0, &options, &Context::silent("distfield"));
    let result = result.expect("a ball");
    assert!((volume(&result.field) / (4.0 / 3.0 * std::f64::consts::PI * 216.0) - 1.0).abs() < 0.02);
    // the other side of the surface is a box with a cavity
    let result = extract(&image, 6.0, Border::Cap);
    assert_eq!((result.parts_after.components, result.parts_after.cavities), (1, 1));
}

#[test]
fn a_part_that_is_dropped_leaves_the_distance_of_the_other() {
    let (left, right) = (DVec3::new(9.2, 9.4, 9.1), DVec3::new(24.3, 9.1, 9.3));
    let balls = |p: DVec3| (6.0 - p.distance(left)).max(3.0 - p.distance(right)) as f32;
    let image = sampled([32, 20, 20], DVec3::ONE, balls);
    let options = capped(Inside::Above, Keep::Largest);
    let result = from_scalar(image, 0.0, &options, &Context::silent("distfield")).expect("a ball");
    assert_eq!((result.dropped.components, result.parts_after.components), (1, 1));
    let volume = 4.0 / 3.0 * std::f64::consts::PI * 27.0;
    assert!((result.dropped.volume / volume - 1.0).abs() < 0.1, "{:?}", result.dropped.volume);
    let (band, all) = distance_errors(&result, |p| p.distance(left) - 6.0);
    println!("the ball that stays: band error {band:.4}, largest {all:.3} voxel");
    // the spline oscillates slightly where the distances to the two balls are equal, and at the
    // centre of a ball, where the distance has a tip
    assert!(band < 0.02 && all < 0.1, "band error {band}, largest {all}");
}

/// In noise with a large range of values, F cuts some of the necks between parts.
#[test]
fn keep_largest_leaves_one_part_of_noise() {
    let options = capped(Inside::Above, Keep::Largest);
    let mut cut_off = 0;
    for seed in 20..26 {
        let mut image = sampled([20; 3], DVec3::ONE, |_| 0.0);
        let noise = |n: usize| isoparticles_field::random::uniform(seed, 0, n as u64) as f32;
        image.data.iter_mut().enumerate().for_each(|(n, value)| *value = (14.0 * noise(n)).exp());
        let result = from_scalar(image, 18000.0, &options, &Context::silent("distfield")).expect("some part");
        println!("seed {seed}: {:?} {} {}", result.parts_after, result.dropped.cut_off, result.undecided);
        assert_eq!(result.parts_after.components, 1);
        cut_off += result.dropped.cut_off;
    }
    assert!(cut_off > 0, "the noise has no neck that F cuts");
}

/// Multiplication by a power of two loses no precision, so the results agree to the last bit.
#[test]
fn the_unit_of_the_voxels_does_not_matter() {
    let image = sampled([24, 24, 24], DVec3::ONE, |p| (8.0 - p.distance(DVec3::new(11.3, 11.9, 11.6))) as f32);
    let own = extract(&image, 0.5, Border::Cap);
    for unit in [2f32.powi(-45), 2f32.powi(100)] {
        let other = Image { geometry: image.geometry.clone(), data: image.data.iter().map(|v| unit * v).collect() };
        let result = extract(&other, f64::from(0.5 * unit), Border::Cap);
        assert_eq!(own.field.data, result.field.data, "{unit}");
        assert_eq!(own.shift.max, result.shift.max, "{unit}");
    }
}

/// A shape with its exact distances.
struct Shape<'a> {
    name: &'a str,
    size: usize,
    /// Signed distance in voxels; NaN where it is unknown.
    distance: &'a dyn Fn(DVec3) -> f64,
    /// Distance to the medial axis in voxels.
    axis: &'a dyn Fn(DVec3) -> f64,
}

/// Returns the value of a blurred edge at a signed distance (in voxels) from its middle.
fn edge(distance: f64) -> f32 {
    (0.5 - 0.5 * (distance / 2.0).tanh()) as f32
}

/// Checks the values and slopes of the spline at the nodes and between them, at least four voxels
/// from the medial axis. Closer to the medial axis, the spline rounds the kink.
fn check_far_field(shape: &Shape, image: &Image<f32>, iso: f64, border: Border) {
    let Shape { name, size, distance, axis } = *shape;
    let result = extract(image, iso, border);
    let spline = CubicSpline::new(&result.field);
    let margin = DVec3::splat(MARGIN as f64);
    let (mut band, mut all, mut slope, mut checked) = (0.0f64, 0.0f64, 0.0f64, 0);
    for node in positions(&image.geometry) {
        // the spline is mirrored at the border of F and oscillates within three voxels of it
        let is_inner = node.min_element() >= 0.0 && node.max_element() <= size as f64 - 2.0;
        for p in [node, node + DVec3::new(0.5, 0.31, 0.44)] {
            let truth = distance(p);
            if !is_inner || truth.is_nan() || axis(p) < 4.0 {
                continue;
            }
            let (value, gradient) = spline.value_gradient(p + margin);
            let error = (value - truth).abs();
            band = if truth.abs() < 2.5 { band.max(error) } else { band };
            all = all.max(error);
            slope = slope.max((gradient.length() - 1.0).abs());
            checked += 1;
        }
    }
    println!("{name}: band error {band:.4}, largest {all:.4} voxel, slope off by {slope:.4}, {:?}", result.shift);
    assert!(checked > 10_000, "{name}: {checked} places");
    // measured maxima: 0.0043, 0.014 and 0.018
    assert!(band < 0.01 && all < 0.02, "{name}: band error {band}, largest {all}");
    assert!(slope < 0.02, "{name}: slope off by {slope}");
    assert!(result.shift.mean < 0.002, "{name}: {:?}", result.shift);
}

#[test]
fn a_ball_and_a_torus_have_slope_one_off_the_medial_axis() {
    for size in [64, 128] {
        let scale = size as f64 / 64.0;
        let centre = DVec3::splat(0.5 * (size as f64 - 1.0)) + DVec3::new(0.137, 0.291, -0.173);
        let from_axis = |p: DVec3| (p - centre).truncate().length();
        let tube = |p: DVec3| (from_axis(p) - 17.9 * scale).hypot(p.z - centre.z);
        let shapes = [
            Shape {
                name: "ball",
                size,
                distance: &|p| p.distance(centre) - 19.2 * scale,
                axis: &|p| p.distance(centre),
            },
            Shape { name: "torus", size, distance: &|p| tube(p) - 7.7 * scale, axis: &|p| tube(p).min(from_axis(p)) },
        ];
        for shape in shapes {
            let image = sampled([size; 3], DVec3::ONE, |p| edge((shape.distance)(p)));
            check_far_field(&shape, &image, 0.5, Border::Cap);
        }
    }
}

#[test]
fn an_ellipsoid_has_slope_one_off_the_medial_axis() {
    let centre = DVec3::new(31.7, 31.4, 31.6);
    let axes = DVec3::new(27.0, 21.0, 16.0);
    let distance = |p: DVec3| ellipsoid_distance(p - centre, axes);
    // The inner medial axis is an elliptical disc in the plane of the two longer axes. The ends of
    // its axes are centres of curvature of the ellipsoid.
    let disc = DVec3::new(axes.x - axes.z.powi(2) / axes.x, axes.y - axes.z.powi(2) / axes.y, 1e-4);
    let axis = |p: DVec3| ellipsoid_distance(p - centre, disc).abs();
    let image = sampled([64; 3], DVec3::ONE, |p| edge(distance(p)));
    check_far_field(&Shape { name: "ellipsoid", size: 64, distance: &distance, axis: &axis }, &image, 0.5, Border::Cap);
}

/// Wave number of [`gyroid`], per voxel. It is also the maximum curvature of its surface.
const WAVE: f64 = 0.05;

/// Returns the value of a gyroid, positive inside, and its gradient.
fn gyroid(p: DVec3) -> (f64, DVec3) {
    let [(sx, cx), (sy, cy), (sz, cz)] = (p * WAVE).to_array().map(f64::sin_cos);
    let gradient = DVec3::new(cx * cy - sz * sx, cy * cz - sx * sy, cz * cx - sy * sz) * WAVE;
    (sx * cy + sy * cz + sz * cx, gradient)
}

/// Returns the point of the gyroid near a position, by Newton's method along the gradient.
fn onto_gyroid(mut p: DVec3) -> DVec3 {
    for _ in 0..6 {
        let (value, gradient) = gyroid(p);
        p -= gradient * (value / gradient.length_squared());
    }
    p
}

/// Returns the signed distance to the gyroid in voxels. Returns NaN beyond `farthest` voxels, and
/// where the foot is close to the border of the volume or outside it: the spline of the input is
/// mirrored at the border, so its zero set differs there.
fn gyroid_distance(node: DVec3, farthest: f64) -> f64 {
    let mut foot = onto_gyroid(node);
    // Moves along tangent planes. Each step multiplies the error by at most the ratio of the
    // distance to the radius of curvature.
    for _ in 0..60 {
        let normal = gyroid(foot).1.normalize();
        let way = node - foot;
        foot = onto_gyroid(foot + way - normal * way.dot(normal));
    }
    let distance = node.distance(foot);
    let is_known = distance < farthest && foot.min_element() > 6.0 && foot.max_element() < 57.0;
    if is_known { distance.copysign(-gyroid(node).0) } else { f64::NAN }
}

#[test]
fn a_gyroid_has_slope_one_off_the_medial_axis() {
    // within this distance of the surface, a node is at least five voxels from a focal point and
    // nearer to the surface than to the opposite side of the channel
    let distance = |node: DVec3| gyroid_distance(node, 1.0 / WAVE - 5.0);
    let image = sampled([64; 3], DVec3::ONE, |p| gyroid(p).0 as f32);
    let shape = Shape { name: "gyroid", size: 64, distance: &distance, axis: &|_| f64::INFINITY };
    check_far_field(&shape, &image, 0.0, Border::Open);
}

#[test]
fn an_object_in_the_corners_of_the_volume_has_no_voids_there() {
    let centre = DVec3::splat(17.5);
    let image = sampled([36; 3], DVec3::ONE, |p| (60.0 * (p.distance(centre) - 10.0)).clamp(-400.0, 400.0) as f32);
    let result = extract(&image, 0.0, Border::Cap);
    let topology = FieldTopology::new(&CubicSpline::new(&result.field));
    let euler: Vec<i64> = topology.components().iter().map(|component| component.euler).collect();
    assert_eq!((euler, topology.undecided().len()), (vec![2, 2], 0));
    assert!(result.shift.max < 0.06, "{:?}", result.shift);
}
