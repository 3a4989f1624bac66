//! Edits of the mesh: the log records them until they are rolled back or committed.

use super::{Change, DEAD, Facts, Surface};
use crate::improve::functions::Freedom;
use crate::interfaces::Interface;
use glam::DVec3;

impl Surface<'_> {
    /// Moves a vertex.
    pub(in crate::improve) fn move_vertex(&mut self, vertex: u32, to: DVec3) {
        self.move_vertex_of(vertex, to, (self.size)(to));
    }

    /// Moves a vertex to a position with a known target length.
    pub(in crate::improve) fn move_vertex_of(&mut self, vertex: u32, to: DVec3, target: f64) {
        let v = vertex as usize;
        self.log.push(Change::Moved { vertex, from: self.positions[v], target: self.target[v] });
        self.positions[v] = to;
        self.target[v] = target;
    }

    /// Adds a vertex and returns its index.
    pub(in crate::improve) fn add_vertex(&mut self, at: DVec3) -> u32 {
        self.add_vertex_of(at, (self.size)(at))
    }

    /// Adds a vertex at a position with a known target length, and returns its index.
    pub(in crate::improve) fn add_vertex_of(&mut self, at: DVec3, target: f64) -> u32 {
        self.log.push(Change::VertexAdded);
        self.positions.push(at);
        self.target.push(target);
        self.around.push(Vec::new());
        self.frozen.push(false);
        self.freedom.push(Freedom::Interface);
        self.positions.len() as u32 - 1
    }

    /// Adds a triangle to an interface and returns its index.
    pub(in crate::improve) fn add_triangle(&mut self, corners: [u32; 3], pair: Interface) -> u32 {
        self.log.push(Change::TriangleAdded);
        self.triangles.push(DEAD);
        self.pair.push(pair);
        self.facts.push(Facts::NONE);
        let t = self.triangles.len() as u32 - 1;
        self.set_triangle(t, corners);
        t
    }

    /// Changes the corners of a triangle, or removes it ([`DEAD`]).
    pub(in crate::improve) fn set_triangle(&mut self, triangle: u32, corners: [u32; 3]) {
        self.log.push(Change::Retriangled { triangle, from: self.triangles[triangle as usize] });
        self.rewire(triangle, corners);
    }

    fn rewire(&mut self, triangle: u32, corners: [u32; 3]) {
        let old = std::mem::replace(&mut self.triangles[triangle as usize], corners);
        for v in old {
            if v != u32::MAX && !corners.contains(&v) {
                let list = &mut self.around[v as usize];
                if let Ok(at) = list.binary_search(&triangle) {
                    list.remove(at);
                }
            }
        }
        for v in corners {
            if v != u32::MAX && !old.contains(&v) {
                let list = &mut self.around[v as usize];
                if let Err(at) = list.binary_search(&triangle) {
                    list.insert(at, triangle);
                }
            }
        }
    }

    /// Returns the current position in the log, for [`Self::rollback_to`].
    pub(in crate::improve) fn mark(&self) -> usize {
        self.log.len()
    }

    /// Rolls back all edits since the last commit.
    pub(in crate::improve) fn rollback(&mut self) {
        self.rollback_to(0);
    }

    /// Rolls back all edits since a mark.
    pub(in crate::improve) fn rollback_to(&mut self, mark: usize) {
        self.tried += usize::from(self.log.len() > mark);
        while self.log.len() > mark
            && let Some(change) = self.log.pop()
        {
            match change {
                Change::Moved { vertex, from, target } => {
                    self.positions[vertex as usize] = from;
                    self.target[vertex as usize] = target;
                }
                Change::Retriangled { triangle, from } => self.rewire(triangle, from),
                Change::VertexAdded => {
                    self.positions.pop();
                    self.target.pop();
                    self.around.pop();
                    self.frozen.pop();
                    self.freedom.pop();
                }
                Change::TriangleAdded => {
                    self.triangles.pop();
                    self.pair.pop();
                    self.facts.pop();
                }
            }
        }
    }

    /// Returns the touched triangles: those that were edited, added or removed since the last
    /// commit, and those at moved vertices, in ascending order.
    pub(in crate::improve) fn touched(&self) -> Vec<u32> {
        let mut touched = Vec::new();
        for change in &self.log {
            match *change {
                Change::Moved { vertex, .. } => touched.extend(&self.around[vertex as usize]),
                Change::Retriangled { triangle, .. } => touched.push(triangle),
                Change::VertexAdded | Change::TriangleAdded => {}
            }
        }
        touched.sort_unstable();
        touched.dedup();
        touched
    }

    /// Returns whether the edits since the last commit move or remove a vertex of a junction curve.
    pub(in crate::improve) fn changes_a_curve(&self) -> bool {
        let is_on_curve = |v: u32| v != u32::MAX && self.freedom[v as usize] == Freedom::Curve;
        self.log.iter().any(|change| match *change {
            Change::Moved { vertex, .. } => is_on_curve(vertex),
            Change::Retriangled { from, .. } => {
                from.iter().any(|&v| is_on_curve(v) && self.around[v as usize].is_empty())
            }
            Change::VertexAdded | Change::TriangleAdded => false,
        })
    }

    /// Returns those of the touched triangles that existed at the last commit, with their corners
    /// (mm) at that time.
    pub(in crate::improve) fn former_corners(&self, touched: &[u32]) -> Vec<(u32, [DVec3; 3])> {
        let mut moved: Vec<(u32, DVec3)> = Vec::new();
        let mut retriangled: Vec<(u32, [u32; 3])> = Vec::new();
        for change in &self.log {
            match *change {
                Change::Moved { vertex, from, .. } if moved.iter().all(|m| m.0 != vertex) => moved.push((vertex, from)),
                Change::Retriangled { triangle, from } if retriangled.iter().all(|r| r.0 != triangle) => {
                    retriangled.push((triangle, from));
                }
                _ => {}
            }
        }
        touched
            .iter()
            .map(|&t| (t, retriangled.iter().find(|r| r.0 == t).map_or(self.triangles[t as usize], |r| r.1)))
            .filter(|(_, corners)| *corners != DEAD)
            .map(|(t, c)| {
                let place = |v| moved.iter().find(|m| m.0 == v).map_or(self.positions[v as usize], |m| m.1);
                (t, c.map(place))
            })
            .collect()
    }

    /// Returns whether a triangle has changed since the surface was created.
    pub(in crate::improve) fn has_changed(&self, triangle: u32) -> bool {
        self.has_changed[triangle as usize]
    }

    /// Returns whether the touched triangles lie strictly inside the region, or there is no region.
    pub(in crate::improve) fn is_within_region(&self, touched: &[u32]) -> bool {
        let mut corners = touched.iter().filter(|&&t| self.is_alive(t)).flat_map(|&t| self.corners(t));
        self.region.is_none_or(|region| corners.all(|p| region.encloses(p)))
    }

    /// Commits the edits since the last commit without the acceptance test. Returns the touched
    /// triangles.
    #[cfg(test)]
    pub(in crate::improve) fn commit_as_it_is(&mut self) -> Vec<u32> {
        let touched = self.touched();
        let facts: Vec<Facts> = touched.iter().map(|&t| self.measure(t)).collect();
        self.commit(&touched, &facts);
        touched
    }

    /// Commits the edits since the last commit.
    pub(in crate::improve) fn commit(&mut self, touched: &[u32], facts: &[Facts]) {
        self.tried += 1;
        self.has_changed.resize(self.triangles.len(), false);
        for (&t, &fact) in touched.iter().zip(facts) {
            self.has_changed[t as usize] = true;
            let bounds = self.is_alive(t).then(|| self.bounds(t));
            if let Some(grid) = &mut self.grid {
                if self.facts[t as usize] != Facts::NONE {
                    grid.remove(t);
                }
                if let Some(bounds) = bounds {
                    grid.insert(t, bounds);
                }
            }
            self.facts[t as usize] = fact;
        }
        self.log.clear();
    }
}
