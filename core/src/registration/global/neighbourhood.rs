//! All points within a radius, through boxes of that size.

/// Points sorted into boxes as wide as the radius.
pub(super) struct Neighbourhoods<'a> {
    points: &'a [[f32; 3]],
    radius: f32,
    low: [f32; 3],
    size: [i32; 3],
    /// The first of `members` of each box, and the end.
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl<'a> Neighbourhoods<'a> {
    /// Sorts finite points.
    pub fn new(points: &'a [[f32; 3]], radius: f32) -> Self {
        let mut low = [f32::INFINITY; 3];
        let mut high = [f32::NEG_INFINITY; 3];
        for point in points {
            for axis in 0..3 {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
            }
        }
        let size = std::array::from_fn(|axis| ((high[axis] - low[axis]) / radius) as i32 + 1);
        let mut sorted = Self { points, radius, low, size, starts: Vec::new(), members: Vec::new() };
        let boxes = if points.is_empty() { 0 } else { size.iter().map(|s| *s as usize).product() };
        let mut starts = vec![0_u32; boxes + 1];
        for point in points {
            starts[sorted.index(sorted.place(*point)) + 1] += 1;
        }
        for k in 0..boxes {
            starts[k + 1] += starts[k];
        }
        let mut next = starts.clone();
        sorted.members = vec![0; points.len()];
        for (index, point) in points.iter().enumerate() {
            let at = sorted.index(sorted.place(*point));
            sorted.members[next[at] as usize] = index as u32;
            next[at] += 1;
        }
        sorted.starts = starts;
        sorted
    }

    /// Fills `found` with the other points within the radius and their distances.
    pub fn find(&self, index: usize, found: &mut Vec<(u32, f32)>) {
        found.clear();
        let own = self.points[index];
        let [x, y, z] = self.place(own);
        let around = |c: i32, size: i32| (c - 1).max(0)..=(c + 1).min(size - 1);
        for bx in around(x, self.size[0]) {
            for by in around(y, self.size[1]) {
                for bz in around(z, self.size[2]) {
                    let at = self.index([bx, by, bz]);
                    for other in &self.members[self.starts[at] as usize..self.starts[at + 1] as usize] {
                        let p = self.points[*other as usize];
                        let d: [f32; 3] = std::array::from_fn(|axis| p[axis] - own[axis]);
                        let distance_sq = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
                        if distance_sq <= self.radius * self.radius && *other as usize != index {
                            found.push((*other, distance_sq.sqrt()));
                        }
                    }
                }
            }
        }
    }

    fn place(&self, point: [f32; 3]) -> [i32; 3] {
        std::array::from_fn(|axis| (((point[axis] - self.low[axis]) / self.radius) as i32).min(self.size[axis] - 1))
    }

    fn index(&self, place: [i32; 3]) -> usize {
        (place[0] as usize * self.size[1] as usize + place[1] as usize) * self.size[2] as usize + place[2] as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_finds_what_looking_at_every_point_finds(
            points in prop::collection::vec(prop::array::uniform3(-6.0f32..6.0), 1..80),
        ) {
            let sorted = Neighbourhoods::new(&points, 2.5);
            let mut found = Vec::new();
            for index in 0..points.len() {
                sorted.find(index, &mut found);
                let mut indices: Vec<usize> = found.iter().map(|f| f.0 as usize).collect();
                indices.sort_unstable();
                let near = |k: &usize| {
                    let d: [f32; 3] = std::array::from_fn(|axis| points[*k][axis] - points[index][axis]);
                    *k != index && d[0] * d[0] + d[1] * d[1] + d[2] * d[2] <= 2.5 * 2.5
                };
                prop_assert_eq!(indices, (0..points.len()).filter(near).collect::<Vec<_>>());
            }
        }
    }
}
