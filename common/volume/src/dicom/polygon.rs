//! Fills polygons by the even-odd rule.

use super::stack::ROUNDING;
use glam::DVec2;

/// Marks the pixels of a mask of `size` pixels whose centres are inside the closed polygons. The
/// corners are index positions. Polygons inside others are holes. Centres within [`ROUNDING`] of an
/// edge are inside, because programs that trace a mask draw the edges through the centres of its
/// outermost pixels.
pub(super) fn fill(polygons: &[&[DVec2]], [columns, rows]: [usize; 2]) -> Vec<bool> {
    let mut mask = vec![false; columns * rows];
    // the columns from `low` to `high` in a row
    let range = |low: f64, high: f64| {
        let start = low.ceil().max(0.0) as usize;
        // a range to the left of the mask is empty
        start..((high.floor() + 1.0).max(0.0) as usize).min(columns).max(start)
    };
    let mut crossings: Vec<Vec<f64>> = vec![Vec::new(); rows];
    for polygon in polygons {
        for (n, &end) in polygon.iter().enumerate() {
            let start = polygon[if n == 0 { polygon.len() - 1 } else { n - 1 }];
            let (low, high) = if start.y <= end.y { (start, end) } else { (end, start) };
            let last = (high.y + ROUNDING).floor().min(rows as f64 - 1.0);
            let first = (low.y - ROUNDING).ceil().max(0.0);
            if first > last {
                continue;
            }
            for row in first as usize..=last as usize {
                let y = row as f64;
                let part = |y: f64| if high.y > low.y { ((y - low.y) / (high.y - low.y)).clamp(0.0, 1.0) } else { 0.0 };
                let x = |y: f64| low.x + part(y) * (high.x - low.x);
                // a row contains the lower end of an edge, but not the upper one
                if low.y <= y && y < high.y {
                    crossings[row].push(x(y));
                }
                let ends = if high.y > low.y { [x(y - ROUNDING), x(y + ROUNDING)] } else { [low.x, high.x] };
                let near = range(ends[0].min(ends[1]) - ROUNDING, ends[0].max(ends[1]) + ROUNDING);
                mask[row * columns..][..columns].get_mut(near).into_iter().flatten().for_each(|pixel| *pixel = true);
            }
        }
    }
    for (row, mut crossings) in crossings.into_iter().enumerate() {
        crossings.sort_by(f64::total_cmp);
        for pair in crossings.chunks_exact(2) {
            let inside = range(pair[0], pair[1]);
            mask[row * columns..][..columns].get_mut(inside).into_iter().flatten().for_each(|pixel| *pixel = true);
        }
    }
    mask
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(polygons: &[&[DVec2]]) -> String {
        let mask = fill(polygons, [6, 5]);
        mask.chunks(6)
            .map(|row| row.iter().map(|&inside| if inside { '#' } else { '.' }).collect::<String>() + "\n")
            .collect()
    }

    fn square(low: f64, high: f64) -> [DVec2; 4] {
        [(low, low), (high, low), (high, high), (low, high)].map(DVec2::from)
    }

    #[test]
    fn inner_polygons_are_holes() {
        let expected = "......\n.####.\n.#..#.\n.#..#.\n.####.\n";
        assert_eq!(filled(&[&square(0.5, 4.4), &square(1.5, 3.4)]), expected);
        // a keyhole: one polygon with a channel of no width to the hole
        let [outer, inner] = [square(0.5, 4.4), square(1.5, 3.4)];
        let keyhole = [&outer[..], &outer[..1], &[inner[0], inner[3], inner[2], inner[1], inner[0]]].concat();
        assert_eq!(filled(&[&keyhole]), expected);
    }

    #[test]
    fn centres_on_an_edge_are_inside() {
        let expected = "......\n.###..\n.###..\n.###..\n......\n";
        assert_eq!(filled(&[&square(1.0, 3.0)]), expected);
        let triangle = [(1.0, 1.0), (4.0, 1.0), (1.0, 4.0)].map(DVec2::from);
        assert_eq!(filled(&[&triangle]), "......\n.####.\n.###..\n.##...\n.#....\n");
    }

    #[test]
    fn polygons_beyond_the_mask_are_cut_off() {
        assert_eq!(filled(&[&square(-100.0, 100.0)]), "######\n".repeat(5));
        assert_eq!(filled(&[&square(-100.0, -50.0), &square(50.0, 1e300), &[]]), "......\n".repeat(5));
    }
}
