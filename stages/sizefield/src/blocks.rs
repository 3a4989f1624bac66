//! Grades h by marching over the grid in blocks. Each block fits into the cache of a core. The
//! blocks are processed in parallel.
//!
//! With a single queue for the whole grid, nodes would be evicted from the cache before the march
//! returns to them. Each block therefore has its own queue, which sorts the nodes into buckets by
//! value, and processes several buckets at a time. Changes at the faces of a block are sent to the
//! adjacent blocks. This is a two-scale method (Chacon and Vladimirsky 2012). The blocks are
//! coloured in a checkerboard pattern. Blocks of the same colour run in parallel and do not use
//! each other's values, so the result does not depend on the number of threads.

use crate::scheme::{NodeSet, Scheme, Values};
use rayon::prelude::*;
use std::collections::VecDeque;

/// Number of nodes along each axis of a block. A block including its border has 34^3 values (157
/// kB), which fit into a second-level cache of 256 kB. Blocks of 64^3 nodes would need more than 16
/// bits per node index.
const BLOCK_SIDE: usize = 32;

/// Width of a bucket, as a fraction of the allowed change of h between adjacent nodes (minimum over
/// the axes). A node's value exceeds the smallest value that it depends on by at least 1 / sqrt(3)
/// of this change, so the node with this smallest value is always in an earlier bucket. For a
/// sphere in a grid of 128^3 nodes, the march tests each node 2.95, 3.03, 3.22 and 3.48 times on
/// average with widths of 0.25, 0.5, 1 and 2.
const BUCKET_WIDTH: f64 = 0.5;
const _: () = assert!(3.0 * BUCKET_WIDTH * BUCKET_WIDTH < 1.0, "a bucket is wider than a step along a diagonal");

/// Number of buckets that a block processes in one turn, before it receives messages from other
/// blocks. For the sphere described at [`BUCKET_WIDTH`], 1, 8, 16 and 64 buckets per turn result in
/// 3.00, 3.03, 3.14 and 3.81 tests per node. More buckets per turn mean fewer turns.
const BUCKETS_PER_TURN: u64 = 8;

/// Number of nodes along each axis of a block, including one border node at each end.
const BORDERED_SIDE: usize = BLOCK_SIDE + 2;
const _: () =
    assert!(BORDERED_SIDE * BORDERED_SIDE * BORDERED_SIDE <= 1 << 16, "places that are asked for have 16 bits");

/// Index of a node in the bordered block, and its value when it was queued.
type Queued = (u32, f32);

/// Index of the receiving block, and a node to add to its queue.
type Message = (usize, Queued);

/// The blocks of a grid.
pub(crate) struct Blocks<'a> {
    scheme: &'a Scheme,
    values: &'a Values,
    blocks: Vec<Block>,
    /// Whether the march ends as soon as all requested nodes have their final values.
    ends: bool,
}

/// A part of the grid: its own nodes, and a border of nodes that belong to adjacent blocks.
struct Block {
    /// Index, in the bordered grid, of the block's first border node.
    origin: usize,
    /// Number of the block's own nodes along each axis. Their positions in the bordered block start
    /// at 1.
    size: [usize; 3],
    /// Indices of the previous and the next block along each axis; `None` at the edge of the grid.
    beside: [[Option<usize>; 2]; 3],
    /// Colour in the checkerboard pattern, 0 or 1.
    colour: usize,
    /// Requested nodes that may still be lowered, as indices in the bordered block.
    asked: Vec<u16>,
    queue: Queue,
}

impl<'a> Blocks<'a> {
    /// Divides a grid of `size` nodes into blocks and queues all nodes with finite values. If
    /// `asked` is given, only the nodes in it need final values.
    pub(crate) fn new(size: [usize; 3], scheme: &'a Scheme, values: &'a Values, asked: Option<&NodeSet>) -> Self {
        let count = size.map(|n| n.div_ceil(BLOCK_SIDE));
        let step = [1, count[0], count[0] * count[1]];
        let width = BUCKET_WIDTH * scheme.rise.iter().copied().fold(f64::INFINITY, f64::min);
        let block = |n: usize| {
            let place = [n % count[0], n / count[0] % count[1], n / (count[0] * count[1])];
            let mut block = Block {
                origin: (0..3).map(|a| BLOCK_SIDE * place[a] * scheme.strides[a]).sum(),
                size: std::array::from_fn(|a| BLOCK_SIDE.min(size[a] - BLOCK_SIDE * place[a])),
                beside: std::array::from_fn(|a| {
                    [(place[a] > 0).then(|| n - step[a]), (place[a] + 1 < count[a]).then(|| n + step[a])]
                }),
                colour: place.iter().sum::<usize>() % 2,
                asked: Vec::new(),
                queue: Queue::new(width),
            };
            if let Some(asked) = asked {
                let first = place.map(|n| BLOCK_SIDE * n);
                let number = |[i, j, k]: [usize; 3]| {
                    first[0] + i - 1 + size[0] * (first[1] + j - 1 + size[1] * (first[2] + k - 1))
                };
                block.asked =
                    block.own().filter(|&place| asked.contains(number(place))).map(|p| index(p) as u16).collect();
            }
            block.queue.sources = block.sources(scheme, values);
            block
        };
        let blocks = (0..count.iter().product()).into_par_iter().map(block).collect();
        Self { scheme, values, blocks, ends: asked.is_some() }
    }

    /// Marches until all requested nodes have their final values, or until all nodes do if none are
    /// requested.
    pub(crate) fn march(mut self) {
        // enter the thread pool once instead of once per turn
        rayon::scope(|_| {
            while let Some(first) = self.blocks.iter().filter_map(|block| block.queue.first()).min() {
                if self.ends && !self.is_any_above(first) {
                    break;
                }
                for colour in 0..2 {
                    self.turn(colour, first + BUCKETS_PER_TURN);
                }
            }
        });
    }

    /// Returns whether the value of any requested node exceeds the lower bound of a bucket. Removes
    /// the other nodes from `asked`, because their values are final.
    fn is_any_above(&mut self, bucket: u64) -> bool {
        let (scheme, values, reached) = (self.scheme, self.values, self.blocks[0].queue.least(bucket));
        self.blocks.par_iter_mut().for_each(|block| {
            let mut asked = std::mem::take(&mut block.asked);
            asked.retain(|&at| f64::from(values.get(block.node(scheme, place(u32::from(at))))) > reached);
            block.asked = asked;
        });
        self.blocks.iter().any(|block| !block.asked.is_empty())
    }

    /// Processes the buckets before `end` in all blocks of one colour, and delivers their messages.
    fn turn(&mut self, colour: usize, end: u64) {
        let (scheme, values) = (self.scheme, self.values);
        let of_colour = self.blocks.par_iter_mut().filter(|block| block.colour == colour);
        let sent: Vec<Vec<Message>> = of_colour.map(|block| block.march(scheme, values, end)).collect();
        for (block, (at, value)) in sent.into_iter().flatten() {
            self.blocks[block].queue.push(at, value);
        }
    }
}

impl Block {
    /// Converts a position in the bordered block to an index in the bordered grid.
    fn node(&self, scheme: &Scheme, [i, j, k]: [usize; 3]) -> usize {
        self.origin + i + j * scheme.strides[1] + k * scheme.strides[2]
    }

    /// Returns the positions of the block's own nodes.
    fn own(&self) -> impl Iterator<Item = [usize; 3]> {
        let [nx, ny, nz] = self.size;
        (1..=nz).flat_map(move |k| (1..=ny).flat_map(move |j| (1..=nx).map(move |i| [i, j, k])))
    }

    /// Returns the nodes with finite values in the block and its border, in descending order of
    /// value.
    fn sources(&self, scheme: &Scheme, values: &Values) -> Vec<Queued> {
        let around = |axis: usize| 0..self.size[axis] + 2;
        let mut sources = Vec::new();
        for (j, k) in around(2).flat_map(|k| around(1).map(move |j| (j, k))) {
            let row = self.node(scheme, [0, j, k]);
            let valued = around(0).map(|i| (index([i, j, k]), values.get(row + i)));
            sources.extend(valued.filter(|(_, value)| value.is_finite()));
        }
        sources.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        sources
    }

    /// Processes the buckets before `end`. Returns the messages to adjacent blocks.
    fn march(&mut self, scheme: &Scheme, values: &Values, end: u64) -> Vec<Message> {
        let mut messages = Vec::new();
        while let Some(first) = self.queue.first().filter(|&first| first < end) {
            for (at, value) in self.queue.take(first) {
                let place = place(at);
                let node = self.node(scheme, place);
                // skip outdated entries: a node that was lowered after it was queued has a newer
                // entry
                if values.get(node) >= value {
                    self.lower_neighbours(scheme, values, (place, node, value), &mut messages);
                }
            }
        }
        messages
    }

    /// Lowers the neighbours of a node that belong to this block. The node is given by its position
    /// in the bordered block, its index in the bordered grid, and its value.
    #[inline]
    fn lower_neighbours(
        &mut self,
        scheme: &Scheme,
        values: &Values,
        (place, node, value): ([usize; 3], usize, f32),
        messages: &mut Vec<Message>,
    ) {
        let is_own = |axis: usize| place[axis].wrapping_sub(1) < self.size[axis];
        let is_own = [is_own(0), is_own(1), is_own(2)];
        for axis in 0..3 {
            if !is_own[(axis + 1) % 3] || !is_own[(axis + 2) % 3] {
                continue;
            }
            let stride = scheme.strides[axis];
            if place[axis] > 1
                && values.get(node - stride) > value
                && let Some(new) = scheme.lower(values, node - stride)
            {
                let mut next = place;
                next[axis] -= 1;
                self.lowered(next, new, messages);
            }
            if place[axis] < self.size[axis]
                && values.get(node + stride) > value
                && let Some(new) = scheme.lower(values, node + stride)
            {
                let mut next = place;
                next[axis] += 1;
                self.lowered(next, new, messages);
            }
        }
    }

    /// Queues a lowered node in this block, and in the adjacent blocks whose border contains it.
    #[inline]
    fn lowered(&mut self, place: [usize; 3], value: f32, messages: &mut Vec<Message>) {
        self.queue.push(index(place), value);
        for axis in 0..3 {
            let [before, after] = self.beside[axis];
            let mut there = place;
            if let Some(before) = before.filter(|_| place[axis] == 1) {
                there[axis] = BLOCK_SIDE + 1;
                messages.push((before, (index(there), value)));
            }
            if let Some(after) = after.filter(|_| place[axis] == BLOCK_SIDE) {
                there[axis] = 0;
                messages.push((after, (index(there), value)));
            }
        }
    }
}

/// Returns the index of a position in a bordered block.
fn index([i, j, k]: [usize; 3]) -> u32 {
    (i + BORDERED_SIDE * (j + BORDERED_SIDE * k)) as u32
}

/// Returns the position of an index.
fn place(index: u32) -> [usize; 3] {
    let index = index as usize;
    [index % BORDERED_SIDE, index / BORDERED_SIDE % BORDERED_SIDE, index / (BORDERED_SIDE * BORDERED_SIDE)]
}

/// A queue that sorts nodes into buckets by value.
struct Queue {
    width: f64,
    /// 1 / width.
    rate: f64,
    /// The initial nodes, in descending order of value.
    sources: Vec<Queued>,
    /// Buckets of the nodes queued later, starting with bucket number `start`. The first of these
    /// buckets is never empty. The value of a lowered node exceeds the value of the neighbour that
    /// lowered it by at most the allowed change, so few buckets are in use.
    buckets: VecDeque<Vec<Queued>>,
    start: u64,
}

impl Queue {
    fn new(width: f64) -> Self {
        Self { width, rate: 1.0 / width, sources: Vec::new(), buckets: VecDeque::new(), start: 0 }
    }

    fn bucket(&self, value: f32) -> u64 {
        (f64::from(value) * self.rate) as u64
    }

    /// Returns the lower bound of a bucket.
    fn least(&self, bucket: u64) -> f64 {
        bucket as f64 * self.width
    }

    /// Returns the number of the first non-empty bucket.
    fn first(&self) -> Option<u64> {
        let source = self.sources.last().map(|&(_, value)| self.bucket(value));
        let start = (!self.buckets.is_empty()).then_some(self.start);
        source.into_iter().chain(start).min()
    }

    /// Removes and returns the nodes of the first bucket.
    fn take(&mut self, first: u64) -> Vec<Queued> {
        let is_started = self.start == first && !self.buckets.is_empty();
        let mut nodes = if is_started { std::mem::take(&mut self.buckets[0]) } else { Vec::new() };
        while let Some(&(at, value)) = self.sources.last().filter(|&&(_, value)| self.bucket(value) <= first) {
            self.sources.pop();
            nodes.push((at, value));
        }
        while self.buckets.front().is_some_and(Vec::is_empty) {
            self.buckets.pop_front();
            self.start += 1;
        }
        nodes
    }

    fn push(&mut self, at: u32, value: f32) {
        let bucket = self.bucket(value);
        if self.buckets.is_empty() {
            self.start = bucket;
        }
        while bucket < self.start {
            self.buckets.push_front(Vec::new());
            self.start -= 1;
        }
        let place = (bucket - self.start) as usize;
        if place >= self.buckets.len() {
            self.buckets.resize_with(place + 1, Vec::new);
        }
        self.buckets[place].push((at, value));
    }
}
