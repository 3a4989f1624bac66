//! Connected components of a mesh's vertices, by union-find.

/// Component of each vertex (joined through triangles), numbered in order of first appearance; a vertex without
/// triangles is a component of its own.
pub fn of_vertices(count: usize, triangles: &[[u32; 3]]) -> Vec<u32> {
    let mut parent: Vec<u32> = (0..count as u32).collect();
    for t in triangles {
        for [a, b] in [[t[0], t[1]], [t[1], t[2]]] {
            let (a, b) = (root(&mut parent, a), root(&mut parent, b));
            // the smaller index stays the root, so that the result does not depend on the order of the triangles
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    let mut number = vec![u32::MAX; count];
    let mut next = 0;
    (0..count as u32)
        .map(|i| {
            let r = root(&mut parent, i) as usize;
            if number[r] == u32::MAX {
                number[r] = next;
                next += 1;
            }
            number[r]
        })
        .collect()
}

/// The root of a vertex's tree, halving the path on the way.
fn root(parent: &mut [u32], mut i: u32) -> u32 {
    while parent[i as usize] != i {
        parent[i as usize] = parent[parent[i as usize] as usize];
        i = parent[i as usize];
    }
    i
}

#[cfg(test)]
mod tests {
    use super::of_vertices;

    #[test]
    fn numbers_components_by_first_appearance() {
        assert_eq!(of_vertices(7, &[[4, 5, 6], [0, 2, 3], [2, 3, 0]]), [0, 1, 0, 0, 2, 2, 2]);
        assert!(of_vertices(0, &[]).is_empty());
    }
}
