//! Nearest neighbours by a k-d tree in one flat array, rebuilt in place for every scan.

/// The longest neighbour list.
pub(super) const NEIGHBOURS_MAX: usize = 12;

/// Ranges of this many points or fewer are searched one by one.
const LEAF: usize = 12;

/// A point of the tree and its index in the scan.
#[derive(Debug, Clone, Copy)]
pub(super) struct Entry {
    pub(super) position: [f32; 3],
    pub(super) index: u32,
}

/// The nearest neighbours of one point, nearest first, as indices of points.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct NeighbourList {
    count: u32,
    indices: [u32; NEIGHBOURS_MAX],
}

impl NeighbourList {
    pub(super) fn as_slice(&self) -> &[u32] {
        &self.indices[..self.count as usize]
    }

    pub(super) fn of_slots(slots: &[u32], entries: &[Entry]) -> Self {
        let mut list = Self { count: slots.len() as u32, ..Self::default() };
        for (index, slot) in list.indices.iter_mut().zip(slots) {
            *index = entries[*slot as usize].index;
        }
        list
    }
}

/// A balanced k-d tree: the entry in the middle of a range splits it along the axis noted for the middle.
#[derive(Debug, Default)]
pub(super) struct Tree {
    pub(super) entries: Vec<Entry>,
    axes: Vec<u8>,
    pending: Vec<(usize, usize)>,
}

impl Tree {
    /// Rebuilds the tree over new points.
    pub(super) fn rebuild(&mut self, points: impl Iterator<Item = Entry>) {
        self.entries.clear();
        self.entries.extend(points);
        self.axes.clear();
        self.axes.resize(self.entries.len(), 0);
        self.pending.clear();
        self.pending.push((0, self.entries.len()));
        while let Some((from, to)) = self.pending.pop() {
            if to - from <= LEAF {
                continue;
            }
            let (range, middle) = (&mut self.entries[from..to], (to - from) / 2);
            let axis = widest_axis(range);
            // The index breaks ties: the tree depends on the points alone.
            range.select_nth_unstable_by(middle, |a, b| {
                a.position[axis].total_cmp(&b.position[axis]).then(a.index.cmp(&b.index))
            });
            self.axes[from + middle] = axis as u8;
            self.pending.push((from, from + middle));
            self.pending.push((from + middle + 1, to));
        }
    }

    /// The slots of up to `search.wanted` entries nearest to the entry in `slot`, itself excluded, within the radius.
    pub(super) fn nearest(&self, slot: usize, search: &mut Search) {
        search.found = 0;
        search.centre = self.entries[slot].position;
        search.slot = slot;
        self.descend(0, self.entries.len(), search);
    }

    fn descend(&self, from: usize, to: usize, search: &mut Search) {
        if to - from <= LEAF {
            for slot in from..to {
                search.offer(slot, &self.entries[slot].position);
            }
            return;
        }
        let middle = from + (to - from) / 2;
        let axis = usize::from(self.axes[middle]);
        let offset = search.centre[axis] - self.entries[middle].position[axis];
        search.offer(middle, &self.entries[middle].position);
        let (near, far) =
            if offset < 0.0 { ((from, middle), (middle + 1, to)) } else { ((middle + 1, to), (from, middle)) };
        self.descend(near.0, near.1, search);
        if offset * offset <= search.limit2() {
            self.descend(far.0, far.1, search);
        }
    }
}

/// The axis along which the entries spread most.
fn widest_axis(entries: &[Entry]) -> usize {
    let (mut least, mut most) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for entry in entries {
        for axis in 0..3 {
            least[axis] = least[axis].min(entry.position[axis]);
            most[axis] = most[axis].max(entry.position[axis]);
        }
    }
    (0..3).fold(0, |best, axis| if most[axis] - least[axis] > most[best] - least[best] { axis } else { best })
}

/// One search: what is wanted and the best so far, nearest first.
#[derive(Debug)]
pub(super) struct Search {
    pub(super) wanted: usize,
    pub(super) radius2: f32,
    centre: [f32; 3],
    slot: usize,
    found: usize,
    distances2: [f32; NEIGHBOURS_MAX],
    slots: [u32; NEIGHBOURS_MAX],
}

impl Search {
    pub(super) fn new(wanted: usize) -> Self {
        Self {
            wanted: wanted.min(NEIGHBOURS_MAX),
            radius2: 0.0,
            centre: [0.0; 3],
            slot: 0,
            found: 0,
            distances2: [0.0; NEIGHBOURS_MAX],
            slots: [0; NEIGHBOURS_MAX],
        }
    }

    pub(super) fn slots(&self) -> &[u32] {
        &self.slots[..self.found]
    }

    pub(super) fn distances2(&self) -> &[f32] {
        &self.distances2[..self.found]
    }

    /// Squared distance beyond which nothing is of interest.
    fn limit2(&self) -> f32 {
        if self.found == self.wanted { self.distances2[self.found - 1] } else { self.radius2 }
    }

    fn offer(&mut self, slot: usize, position: &[f32; 3]) {
        let square = |axis: usize| (position[axis] - self.centre[axis]) * (position[axis] - self.centre[axis]);
        let distance2 = square(0) + square(1) + square(2);
        if slot == self.slot || distance2 > self.radius2 {
            return;
        }
        if self.found == self.wanted {
            if distance2 >= self.limit2() {
                return;
            }
            self.found -= 1;
        }
        let mut at = self.found;
        while at > 0 && self.distances2[at - 1] > distance2 {
            self.distances2[at] = self.distances2[at - 1];
            self.slots[at] = self.slots[at - 1];
            at -= 1;
        }
        self.distances2[at] = distance2;
        self.slots[at] = slot as u32;
        self.found += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_tree_finds_what_a_full_search_finds(
            points in prop::collection::vec(prop::array::uniform3(-4.0..4.0f32), 1..300), k in 3..=NEIGHBOURS_MAX, radius in 0.1..5.0f32,
        ) {
            let mut tree = Tree::default();
            tree.rebuild(points.iter().enumerate().map(|(i, p)| Entry { position: *p, index: i as u32 }));
            let mut search = Search::new(k);
            search.radius2 = radius * radius;
            for slot in 0..tree.entries.len() {
                tree.nearest(slot, &mut search);
                let centre = tree.entries[slot].position;
                let mut all: Vec<f32> = tree.entries.iter().enumerate().filter(|(s, _)| *s != slot)
                    .map(|(_, e)| (0..3).map(|a| (e.position[a] - centre[a]) * (e.position[a] - centre[a])).sum::<f32>())
                    .filter(|d| *d <= search.radius2).collect();
                all.sort_by(f32::total_cmp);
                all.truncate(k);
                prop_assert_eq!(search.distances2(), &all[..]);
            }
        }
    }

    #[test]
    fn equal_points_do_not_break_the_tree() {
        let mut tree = Tree::default();
        tree.rebuild((0..100).map(|index| Entry { position: [1.0; 3], index }));
        let mut search = Search::new(10);
        search.radius2 = 1.0;
        tree.nearest(50, &mut search);
        assert_eq!(search.slots().len(), 10);
    }
}
