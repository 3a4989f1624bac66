//! Sets of nodes stored as runs along x. A band around a surface has few runs per row, and values
//! at its nodes need memory only for the band, not for the whole grid.

use isoparticles_mesh::buckets::parts_mut;
use rayon::prelude::*;

/// Consecutive nodes of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    /// x index of the first node.
    pub first: u32,
    /// x index after the last node.
    pub end: u32,
    /// Index of the first node among the nodes of all runs, in ascending order.
    pub number: usize,
}

/// A set of grid nodes, stored as maximal runs.
pub struct Runs {
    size: [usize; 3],
    /// Index of the first run of each row, followed by the total number of runs.
    start: Vec<usize>,
    runs: Vec<Run>,
    /// Number of nodes.
    pub count: usize,
}

impl Run {
    /// Returns the x indices of the nodes in the run.
    pub fn columns(&self) -> std::ops::Range<usize> {
        self.first as usize..self.end as usize
    }
}

impl Runs {
    /// Builds the set of nodes for which `keep` is true.
    pub fn of(size: [usize; 3], keep: impl Fn(usize) -> bool + Sync) -> Self {
        let nx = size[0];
        Self::of_rows(size, |row, spans| {
            let mut i = 0;
            while i < nx {
                if keep(row * nx + i) {
                    let first = i;
                    while i < nx && keep(row * nx + i) {
                        i += 1;
                    }
                    spans.push([first as u32, i as u32]);
                }
                i += 1;
            }
        })
    }

    /// Builds runs from the spans that `fill` adds for each row. A span contains the first x index
    /// and the x index after the last node.
    fn of_rows(size: [usize; 3], fill: impl Fn(usize, &mut Vec<[u32; 2]>) + Sync) -> Self {
        let [_, ny, nz] = size;
        let slice = |k: usize| {
            let (mut spans, mut ends) = (Vec::new(), Vec::with_capacity(ny));
            for row in k * ny..(k + 1) * ny {
                fill(row, &mut spans);
                ends.push(spans.len());
            }
            (spans, ends)
        };
        let slices: Vec<_> = (0..nz).into_par_iter().map(slice).collect();
        let mut start = Vec::with_capacity(ny * nz + 1);
        start.push(0);
        let mut runs: Vec<Run> = Vec::with_capacity(slices.iter().map(|(spans, _)| spans.len()).sum());
        let mut count = 0;
        for (spans, ends) in slices {
            let before = runs.len();
            start.extend(ends.into_iter().map(|end| before + end));
            for [first, end] in spans {
                runs.push(Run { first, end, number: count });
                count += (end - first) as usize;
            }
        }
        Self { size, start, runs, count }
    }

    /// Returns all runs in ascending order.
    pub fn all(&self) -> &[Run] {
        &self.runs
    }

    /// Returns the indices in [`Self::all`] of the runs of a row.
    pub fn of_row(&self, row: usize) -> std::ops::Range<usize> {
        self.start[row]..self.start[row + 1]
    }

    /// Returns the runs of a row.
    pub fn row(&self, row: usize) -> &[Run] {
        &self.runs[self.of_row(row)]
    }

    /// Calls `visit(index, nodes)` for all runs in ascending order, with the index in [`Self::all`]
    /// and the range of node indices.
    pub fn each_in_nodes(&self, mut visit: impl FnMut(usize, std::ops::Range<usize>)) {
        let [nx, ny, nz] = self.size;
        for row in 0..ny * nz {
            for index in self.of_row(row) {
                let columns = self.runs[index].columns();
                visit(index, row * nx + columns.start..row * nx + columns.end);
            }
        }
    }

    /// Visits all pairs of a run in `row` and a run in `other` that share an x index. Runs are
    /// identified by their indices in [`Self::all`].
    pub fn each_touching(&self, row: usize, other: usize, mut visit: impl FnMut(usize, usize)) {
        let (mut own, mut near) = (self.of_row(row), self.of_row(other));
        while !own.is_empty() && !near.is_empty() {
            let (a, b) = (self.runs[own.start], self.runs[near.start]);
            if a.first < b.end && b.first < a.end {
                visit(own.start, near.start);
            }
            if a.end <= b.end {
                own.start += 1;
            } else {
                near.start += 1;
            }
        }
    }

    /// Returns the index in [`Self::all`] of the run that contains a node.
    pub fn find(&self, node: usize) -> Option<usize> {
        let (row, i) = (node / self.size[0], (node % self.size[0]) as u32);
        let at = self.start[row] + self.row(row).partition_point(|run| run.end <= i);
        (at < self.start[row + 1] && self.runs[at].first <= i).then_some(at)
    }

    /// Returns the index of a node among the nodes of all runs, in ascending order, or `None` if no
    /// run contains the node.
    pub fn number(&self, node: usize) -> Option<usize> {
        let run = self.runs[self.find(node)?];
        Some(run.number + node % self.size[0] - run.first as usize)
    }

    /// Splits `values`, one per node of the runs, into one part per slice of the grid.
    pub fn slices<'a, T>(&self, values: &'a mut [T]) -> Vec<&'a mut [T]> {
        let [_, ny, nz] = self.size;
        let before = |row: usize| self.runs.get(self.start[row]).map_or(self.count, |run| run.number);
        parts_mut(values, (0..nz).map(|k| before((k + 1) * ny) - before(k * ny)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 3] = [23, 9, 7];

    /// Selects random nodes that are not on the faces of the grid.
    fn is_in(n: usize) -> bool {
        let [nx, ny, nz] = SIZE;
        let at = [n % nx, n / nx % ny, n / (nx * ny)];
        let is_inner = (0..3).all(|a| at[a] > 0 && at[a] + 1 < [nx, ny, nz][a]);
        is_inner && isoparticles_field::random::uniform(3, 0, n as u64) < 0.3
    }

    #[test]
    fn runs_hold_and_number_the_nodes() {
        let count = SIZE.iter().product();
        let runs = Runs::of(SIZE, is_in);
        let nodes: Vec<usize> = (0..count).filter(|&n| is_in(n)).collect();
        assert_eq!(runs.count, nodes.len());
        for n in 0..count {
            assert_eq!(runs.number(n), nodes.binary_search(&n).ok());
        }
        let mut numbers: Vec<usize> = (0..runs.count).collect();
        let plane = SIZE[0] * SIZE[1];
        for (k, slice) in runs.slices(&mut numbers).into_iter().enumerate() {
            assert!(slice.iter().all(|&number| nodes[number] / plane == k));
            assert_eq!(slice.len(), nodes.iter().filter(|&&n| n / plane == k).count());
        }
    }

    #[test]
    fn touching_runs_are_those_with_a_common_column() {
        let runs = Runs::of(SIZE, is_in);
        for row in 0..SIZE[1] * (SIZE[2] - 1) {
            let mut found = Vec::new();
            runs.each_touching(row, row + SIZE[1], |a, b| found.push((a, b)));
            let overlap = |a: usize, b: usize| runs.all()[a].columns().any(|i| runs.all()[b].columns().contains(&i));
            let pairs = runs.of_row(row).flat_map(|a| runs.of_row(row + SIZE[1]).map(move |b| (a, b)));
            assert_eq!(found, pairs.filter(|&(a, b)| overlap(a, b)).collect::<Vec<_>>());
        }
    }
}
