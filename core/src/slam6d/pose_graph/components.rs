//! Which nodes hang together.

/// The connected parts of a graph (disjoint sets, Tarjan 1975); each is named by its first node.
#[derive(Default)]
pub(super) struct Components {
    parents: Vec<usize>,
}

impl Components {
    /// Adds a node without edges.
    pub fn add(&mut self) {
        self.parents.push(self.parents.len());
    }

    /// Joins the parts of two nodes.
    pub fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.shorten(a), self.shorten(b));
        // The lower index stays the name. Paths are halved on the way, which keeps them short all the same.
        self.parents[a.max(b)] = a.min(b);
    }

    /// The first node of the part that a node belongs to.
    pub fn first_of(&self, mut node: usize) -> usize {
        while self.parents[node] != node {
            node = self.parents[node];
        }
        node
    }

    fn shorten(&mut self, mut node: usize) -> usize {
        while self.parents[node] != node {
            self.parents[node] = self.parents[self.parents[node]];
            node = self.parents[node];
        }
        node
    }
}
