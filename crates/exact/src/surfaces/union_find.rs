//! Union-find over triangles. The least triangle of a set is its root, so that no order of joins matters.

/// Disjoint sets of triangles.
pub struct Sets(Vec<u32>);

impl Sets {
    pub fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
    }

    pub fn find(&mut self, mut x: u32) -> u32 {
        while self.0[x as usize] != x {
            self.0[x as usize] = self.0[self.0[x as usize] as usize];
            x = self.0[x as usize];
        }
        x
    }

    pub fn join(&mut self, x: u32, y: u32) {
        let (x, y) = (self.find(x), self.find(y));
        // The least is the root, so that it depends on no order.
        let (least, other) = (x.min(y), x.max(y));
        self.0[other as usize] = least;
    }
}
