//! Assigns voxels that belong to several materials to one of them. The segments of a `.seg.nrrd`
//! file and the masks in a folder can overlap.

use super::choice::Chosen;
use isoparticles_volume::Volume;
use serde::Serialize;
use std::cmp::Reverse;
use std::collections::BTreeMap;

/// The material that keeps a voxel of several materials.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Overlap {
    /// The material listed first. Those that `all` adds come last, the smallest first.
    Listed,
    /// The material with the smallest volume.
    Smaller,
}

/// The voxels in two materials, one of which keeps them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Reassigned {
    /// Name of the material that keeps the voxels.
    pub kept: String,
    /// Name of the material that loses them.
    pub lost: String,
    /// Number of voxels.
    pub voxels: usize,
}

/// Ranks the materials, so that each voxel belongs to one of them. Returns the reassigned voxels by
/// pair of materials, the largest numbers first. Ties of volumes go to the lower material number.
pub fn settle(chosen: &mut Chosen, volume: &Volume, overlap: Overlap) -> Vec<Reassigned> {
    if volume.layer_count() == 1 {
        return Vec::new();
    }
    let combinations = volume.combinations(|at| chosen.number(at));
    let mut voxels = vec![0; chosen.table.len()];
    for (set, count) in &combinations {
        set.iter().for_each(|&id| voxels[usize::from(id)] += count);
    }
    let mut order: Vec<usize> = (1..chosen.table.len()).collect();
    let unordered = match overlap {
        Overlap::Listed => chosen.listed,
        Overlap::Smaller => 0,
    };
    order[unordered..].sort_by_key(|&id| voxels[id]);
    order.into_iter().enumerate().for_each(|(rank, id)| chosen.rank[id] = rank);
    let mut pairs: BTreeMap<[u16; 2], usize> = BTreeMap::new();
    for (set, count) in &combinations {
        let Some(kept) = set.iter().copied().reduce(|a, b| chosen.first(a, b)) else { continue };
        set.iter().filter(|&&lost| lost != kept).for_each(|&lost| *pairs.entry([kept, lost]).or_default() += count);
    }
    let name = |id: u16| chosen.table[usize::from(id)].name.clone();
    let of_pair = |([kept, lost], voxels): ([u16; 2], usize)| Reassigned { kept: name(kept), lost: name(lost), voxels };
    let mut reassigned: Vec<Reassigned> = pairs.into_iter().map(of_pair).collect();
    reassigned.sort_by_key(|pair| Reverse(pair.voxels));
    reassigned
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Border;
    use crate::materials::choice::resolve;
    use crate::materials::grid::LabelGrid;
    use glam::DVec3;
    use isoparticles_field::random::uniform;
    use isoparticles_volume::{Geometry, LayerLabel, Segment, Voxels};

    const NAMES: [&str; 4] = ["a", "b", "c", "d"];

    /// Creates four segments in three layers, with random voxels.
    fn volume() -> Volume {
        let geometry = Geometry::axis_aligned([9, 8, 7], DVec3::ONE);
        let layer = |seed: u64, least: f64, label: fn(f64) -> u8| -> Voxels {
            let voxel = |n: usize| uniform(seed, 0, n as u64);
            let label = |n: usize| if voxel(n) < least { label(voxel(n)) } else { 0 };
            Voxels::U8((0..geometry.voxel_count()).map(label).collect())
        };
        let layers = [layer(1, 0.7, |x| if x < 0.2 { 1 } else { 2 }), layer(2, 0.4, |_| 1), layer(3, 0.3, |_| 1)];
        let [first, second, third] = layers;
        let segment = |(n, name): (usize, &&str)| {
            let at = LayerLabel { layer: n.saturating_sub(1), label: if n == 1 { 2 } else { 1 } };
            Segment { name: (*name).to_owned(), at }
        };
        Volume {
            more_layers: vec![second, third],
            segments: NAMES.iter().enumerate().map(segment).collect(),
            ..Volume::new(geometry, first)
        }
    }

    /// Compares the grid and the reassigned voxels with direct counts, for materials in the given
    /// order of priority.
    fn check(choices: &[&str], overlap: Overlap, order: &[&str]) {
        let volume = volume();
        let choices: Vec<_> = choices.iter().map(|text| text.parse().expect(text)).collect();
        let mut chosen = resolve(&choices, &volume).expect("materials");
        let found = settle(&mut chosen, &volume, overlap);
        let grid = LabelGrid::new(&volume, &chosen, Border::Cap, 3);
        let mask = |name: &&str| {
            let own = chosen.table.iter().find(|material| material.name == **name).expect("a material");
            volume.label_mask(&own.labels)
        };
        let masks: Vec<Vec<bool>> = order.iter().map(mask).collect();
        let mut pairs: BTreeMap<(&str, &str), usize> = BTreeMap::new();
        for (n, &number) in grid.numbers.iter().enumerate() {
            let mut owners = (0..order.len()).filter(|&m| masks[m][n]).map(|m| order[m]);
            let kept = owners.next().unwrap_or("outside");
            assert_eq!(chosen.table[usize::from(number)].name, kept);
            owners.for_each(|lost| *pairs.entry((kept, lost)).or_default() += 1);
        }
        let found: Vec<_> = found.iter().map(|own| ((own.kept.as_str(), own.lost.as_str()), own.voxels)).collect();
        assert!(found.is_sorted_by_key(|(_, voxels)| Reverse(*voxels)));
        assert_eq!(found.into_iter().collect::<BTreeMap<_, _>>(), pairs);
    }

    #[test]
    fn overlaps_are_settled_by_the_stated_order() {
        // of all voxels, a has 20 %, b 50 %, c 40 % and d 30 %
        check(&["all"], Overlap::Listed, &["a", "d", "c", "b"]);
        check(&["b", "all"], Overlap::Listed, &["b", "a", "d", "c"]);
        check(&["c", "d", "b", "a"], Overlap::Listed, &["c", "d", "b", "a"]);
        check(&["c", "d", "b", "a"], Overlap::Smaller, &["a", "d", "c", "b"]);
        check(&["d", "both=a+c"], Overlap::Listed, &["d", "both"]);
        check(&["c", "a+b+d=rest"], Overlap::Smaller, &["c", "rest"]);
    }
}
