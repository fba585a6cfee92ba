//! The facets around each vertex of a triangulation, in flat arrays.

/// See the module's head.
pub(super) struct Around {
    first: Vec<u32>,
    facets: Vec<u32>,
}

impl Around {
    /// Of facets over so many vertices.
    pub(super) fn new(vertices: usize, facets: &[[u32; 3]]) -> Self {
        let mut first = vec![0u32; vertices + 1];
        facets.iter().flatten().for_each(|&v| first[v as usize + 1] += 1);
        (0..vertices).for_each(|v| first[v + 1] += first[v]);
        let mut next = first.clone();
        let mut list = vec![0u32; 3 * facets.len()];
        for (f, t) in facets.iter().enumerate() {
            for &v in t {
                list[next[v as usize] as usize] = f as u32;
                next[v as usize] += 1;
            }
        }
        Self { first, facets: list }
    }

    /// How many vertices there are.
    pub(super) fn vertices(&self) -> usize {
        self.first.len() - 1
    }

    /// Facets around vertex `v`, ascending.
    pub(super) fn of(&self, v: u32) -> &[u32] {
        &self.facets[self.first[v as usize] as usize..self.first[v as usize + 1] as usize]
    }
}
