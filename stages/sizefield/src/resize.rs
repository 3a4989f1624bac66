//! Sets h in regions of a finished sizing field (`--resize`), and keeps it everywhere else.
//!
//! In a region, h becomes the requested size. Near the border it stays smaller if h outside is
//! smaller, because h increases by at most delta per mm from there. Outside, h is lowered to the
//! size in the region plus delta times the distance from it, where it is above this value. h
//! outside never increases, so a larger h in a region leaves the surroundings unchanged.

use crate::args::Args;
use crate::gradation::{NodeSet, limit_gradient};
use crate::region::{SizedNode, sized_nodes};
use isoparticles_field::sizing::SizingField;
use isoparticles_stage::cli::Context;
use isoparticles_stage::error::Result;
use isoparticles_volume::{Geometry, Image};

/// Applies the `--resize` options to a sizing field, in the given order.
pub(crate) fn resized_by(args: &Args, delta: f64, mut sizing: SizingField, context: &Context) -> Result<SizingField> {
    for region in &args.resize {
        let nodes = sized_nodes(region, &sizing.image().geometry, context)?;
        let _step = context.step("resize");
        sizing = resized(&sizing, &nodes, delta);
        context.check_interrupt()?;
    }
    Ok(sizing)
}

/// Returns the field with the given sizes at some nodes, and with |grad h| <= `delta` between these
/// nodes and the others. If a node has several sizes, the minimum applies.
pub fn resized(sizing: &SizingField, nodes: &[SizedNode], delta: f64) -> SizingField {
    let mut whole = sizing.image().clone();
    let part = Part::around(&whole, nodes, delta);
    let filled = || Image::filled(part.geometry.clone(), f32::INFINITY);
    let (mut inside, mut is_inside) = (filled(), NodeSet::new(part.nodes.len()));
    for &(node, size) in nodes {
        let number = part.number(whole.geometry.size, node);
        inside.data[number] = inside.data[number].min(size as f32);
        is_inside.insert(number);
    }
    let mut from_outside = filled();
    for (number, &node) in part.nodes.iter().enumerate().filter(|(number, _)| !is_inside.contains(*number)) {
        from_outside.data[number] = whole.data[node];
    }
    limit_gradient(&mut from_outside, delta, Some(&is_inside));
    for number in (0..part.nodes.len()).filter(|&number| is_inside.contains(number)) {
        inside.data[number] = inside.data[number].min(from_outside.data[number]);
    }
    let mut cone = inside.clone();
    limit_gradient(&mut cone, delta, None);
    for (number, &node) in part.nodes.iter().enumerate() {
        whole.data[node] =
            if is_inside.contains(number) { inside.data[number] } else { whole.data[node].min(cone.data[number]) };
    }
    SizingField::new(whole)
}

/// A box of nodes of a larger grid.
struct Part {
    geometry: Geometry,
    /// Coordinates of the first node of the box in the whole grid, in nodes.
    first: [usize; 3],
    /// Index in the whole grid of each node of the box.
    nodes: Vec<usize>,
}

impl Part {
    /// Returns the box of the given nodes and of all nodes at which h may decrease.
    fn around(whole: &Image<f32>, sized: &[SizedNode], delta: f64) -> Self {
        let geometry = &whole.geometry;
        let highest = whole.data.iter().copied().fold(0.0, f32::max);
        let lowest = sized.iter().map(|(_, size)| *size).fold(f64::INFINITY, f64::min);
        // two more layers of nodes, which the finite differences at the border of the box use
        let reach = (((f64::from(highest) - lowest) / delta).max(0.0) / geometry.spacing).ceil() + 2.0;
        let (mut first, mut last) = (geometry.size, [0; 3]);
        for &(node, _) in sized {
            let at = coordinates(geometry.size, node);
            first = std::array::from_fn(|a| first[a].min(at[a]));
            last = std::array::from_fn(|a| last[a].max(at[a]));
        }
        let first = std::array::from_fn(|a| first[a].saturating_sub(reach[a] as usize));
        let last: [usize; 3] =
            std::array::from_fn(|a| last[a].saturating_add(reach[a] as usize).min(geometry.size[a] - 1));
        let rows = (first[2]..=last[2]).flat_map(|k| (first[1]..=last[1]).map(move |j| (j, k)));
        let nodes = rows.flat_map(|(j, k)| (first[0]..=last[0]).map(move |i| geometry.linear(i, j, k))).collect();
        let size = std::array::from_fn(|a| last[a] + 1 - first[a]);
        Self { geometry: Geometry::axis_aligned(size, geometry.spacing), first, nodes }
    }

    /// Converts the index of a node in the whole grid, which has `size` nodes per axis, to its
    /// index in the box, which must contain the node.
    fn number(&self, size: [usize; 3], node: usize) -> usize {
        let at = coordinates(size, node);
        let [i, j, k] = std::array::from_fn(|a| at[a] - self.first[a]);
        self.geometry.linear(i, j, k)
    }
}

/// Returns the coordinates, in nodes, of a node of a grid with `size` nodes per axis.
fn coordinates(size: [usize; 3], node: usize) -> [usize; 3] {
    [node % size[0], node / size[0] % size[1], node / size[0] / size[1]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::region::Ball;
    use glam::DVec3;

    const DELTA: f64 = 0.4;

    /// Returns h that grows along x from 1 mm with slope 0.2, the nodes in a ball of radius 5 mm
    /// with the given size, and the ball.
    fn slope_and_ball(size: f64) -> (SizingField, Vec<SizedNode>, Ball) {
        let geometry = Geometry::axis_aligned([60, 30, 30], DVec3::new(1.0, 0.8, 1.2));
        let h = Image::sampled(geometry.clone(), |p: DVec3| (1.0 + 0.2 * p.x) as f32);
        let ball = Ball { centre: DVec3::new(20.0, 12.0, 15.0), radius: 5.0, size };
        let nodes = ball.nodes(&geometry).map(|node| (node, size)).collect();
        (SizingField::new(h), nodes, ball)
    }

    #[test]
    fn a_smaller_size_lowers_a_cone_and_nothing_else() {
        let (before, nodes, ball) = slope_and_ball(1.5);
        let after = resized(&before, &nodes, DELTA);
        let geometry = &before.image().geometry;
        let mut kept = 0;
        for (node, (&old, &new)) in before.image().data.iter().zip(&after.image().data).enumerate() {
            let away = geometry.node_to_grid(node).distance(ball.centre) - ball.radius;
            let cone = 1.5 + DELTA * away.max(0.0);
            // the outermost nodes lie up to a cell diagonal inside the ball, and the scheme is of
            // first order
            let (least, most) = (cone.min(f64::from(old)), (1.06 * cone + 0.5).min(f64::from(old)));
            assert!((least - 1e-4..=most + 1e-4).contains(&f64::from(new)), "{node}: {new}, not {least} to {most}");
            kept += usize::from(old.to_bits() == new.to_bits());
        }
        assert!(kept > geometry.voxel_count() / 2, "{kept}");
    }

    #[test]
    fn a_larger_size_changes_only_the_region() {
        let (before, nodes, ball) = slope_and_ball(30.0);
        let after = resized(&before, &nodes, DELTA);
        let inside: Vec<usize> = nodes.iter().map(|(node, _)| *node).collect();
        let at_centre = after.at(ball.centre);
        // 5 mm from the border of the ball, where h is 4 to 6 mm
        assert!((5.5..7.5).contains(&at_centre), "{at_centre}");
        for (node, (&old, &new)) in before.image().data.iter().zip(&after.image().data).enumerate() {
            match inside.binary_search(&node) {
                Ok(_) => assert!(new >= old - 1e-4, "{node}: {new} below {old}"),
                Err(_) => assert_eq!(old.to_bits(), new.to_bits(), "{node}"),
            }
        }
    }

    #[test]
    fn the_part_does_not_affect_the_values() {
        // with a high value far away, the part is the whole grid
        let (before, nodes, _) = slope_and_ball(1.5);
        let mut high = before.image().clone();
        let last = high.data.len() - 1;
        high.data[last] = 1e4;
        let [small, large] = [before, SizingField::new(high)].map(|field| resized(&field, &nodes, DELTA));
        assert_eq!(small.image().data[..last], large.image().data[..last]);
    }
}
