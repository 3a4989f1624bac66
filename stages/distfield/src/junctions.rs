//! Places where two parts of the object, or two gaps, touch along an edge only: faces of four nodes whose opposite corners are on
//! the same side.
//!
//! The grid cannot say there whether the parts are joined; the bilinear saddle can, and marching cubes asks it. For
//! labels the answer is made plain, since the flow tends to leave F near zero at the saddle, which would be a neck or a gap far
//! below the voxel; for every source, F is made to give the source's answer.

use isoparticles_field::marching_cubes::inside_corners_are_joined;
use isoparticles_volume::Image;
use rayon::prelude::*;

/// Four nodes of a grid face, opposite ones on the same side.
#[derive(Clone, Copy, Debug)]
pub struct Junction {
    /// The nodes inside the object.
    pub inside: [usize; 2],
    /// The nodes outside.
    pub outside: [usize; 2],
    /// Whether the inside nodes are joined across the face.
    pub joined: bool,
}

/// Least and largest |F| (mm) that keep a node on its side of the choice made at a junction.
#[derive(Clone, Copy, Debug)]
pub struct Bound {
    /// The node.
    pub node: usize,
    /// Least |F|.
    pub least: f32,
    /// Largest |F|.
    pub most: f32,
}

/// Passes over the junctions that make F agree with its source, at most: junctions share nodes.
const MOST_PASSES: usize = 20;

/// The junctions of an implicit function given at the nodes, negative inside, with the choice its saddles make.
pub fn junctions(nodes: &Image<f32>) -> Vec<Junction> {
    let [nx, ny, nz] = nodes.geometry.size;
    let (data, stride) = (&nodes.data, [1, nx, nx * ny]);
    (0..nz)
        .into_par_iter()
        .flat_map_iter(|k| {
            let mut found = Vec::new();
            for (axis, last) in [(0, nz - 1), (1, nz - 1), (2, nz)] {
                if k >= last {
                    continue;
                }
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                let rows = ny - usize::from(axis != 1);
                let columns = nx - usize::from(axis != 0);
                for j in 0..rows {
                    for at in (k * ny + j) * nx..(k * ny + j) * nx + columns {
                        let corners = [at, at + stride[u], at + stride[u] + stride[v], at + stride[v]];
                        let side = corners.map(|n| data[n] < 0.0);
                        if side[0] == side[2] && side[1] == side[3] && side[0] != side[1] {
                            let (even, odd) = ([corners[0], corners[2]], [corners[1], corners[3]]);
                            let (inside, outside) = if side[0] { (even, odd) } else { (odd, even) };
                            found.push(Junction { inside, outside, joined: is_joined(data, inside, outside) });
                        }
                    }
                }
            }
            found
        })
        .collect()
}

fn is_joined(data: &[f32], inside: [usize; 2], outside: [usize; 2]) -> bool {
    inside_corners_are_joined(inside.map(|n| f64::from(data[n])), outside.map(|n| f64::from(data[n])))
}

/// Bounds that make the choice at each junction plain: the nodes of the side that is joined keep `far` (mm) from the surface, the
/// others come as `near` to it as their own `least` distance (mm, of a node) lets them.
pub fn plain_choices(junctions: &[Junction], least: impl Fn(usize) -> f32, near: f32, far: f32) -> Vec<Bound> {
    let mut bounds: Vec<Bound> = junctions
        .iter()
        .flat_map(|junction| {
            let (winners, losers) =
                if junction.joined { (junction.inside, junction.outside) } else { (junction.outside, junction.inside) };
            let winners = winners.map(|node| Bound { node, least: far, most: f32::INFINITY });
            let losers = losers.map(|node| Bound { node, least: least(node), most: near.max(least(node)) });
            winners.into_iter().chain(losers)
        })
        .collect();
    bounds.sort_by_key(|bound| bound.node);
    bounds.dedup_by(|next, kept| {
        let same = next.node == kept.node;
        if same {
            // a node that wins at one junction and loses at another keeps its distance
            kept.least = kept.least.max(next.least);
            kept.most = kept.most.min(next.most).max(kept.least);
        }
        same
    });
    bounds
}

/// Changes `field` at junctions where it is not joined as they say, by as little as tips the balance; no |F| falls below
/// `least`. Returns the number of junctions that still differ.
pub fn make_agree(field: &mut [f32], junctions: &[Junction], least: &(impl Fn(usize) -> f32 + Sync)) -> usize {
    let mut differing = 0;
    for _ in 0..MOST_PASSES {
        differing = 0;
        for junction in junctions {
            if is_joined(field, junction.inside, junction.outside) == junction.joined {
                continue;
            }
            differing += 1;
            let (winners, losers) =
                if junction.joined { (junction.inside, junction.outside) } else { (junction.outside, junction.inside) };
            let product = |nodes: [usize; 2]| f64::from(field[nodes[0]]) * f64::from(field[nodes[1]]);
            let factor = (1.05 * product(losers) / product(winners)).powf(0.25) as f32;
            for node in winners {
                field[node] *= factor;
            }
            for node in losers {
                field[node] = (field[node].abs() / factor).max(least(node)).copysign(field[node]);
            }
        }
        if differing == 0 {
            break;
        }
    }
    differing
}
