//! The pattern of the normal equations: which blocks of 6x6 there are, in which order the nodes are eliminated, and
//! where in the sparse matrix each edge adds its share. It only changes when the graph grows.

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::sparse::linalg::amd;
use faer::sparse::linalg::cholesky::{simplicial, supernodal};
use faer::sparse::{SymbolicSparseColMat, SymbolicSparseColMatRef};
use nalgebra::{Matrix6, Vector6};

use super::linearisation::Terms;

/// A node that is held where it is.
pub(super) const HELD: usize = usize::MAX;
/// The unknowns of a node.
pub(super) const SIZE: usize = 6;

/// Why the pattern could not be analysed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct OutOfMemory;

/// The pattern of H, lower triangle, in the order of elimination.
pub(super) struct Structure {
    /// The place of each node in the order of elimination, or [`HELD`].
    pub place: Vec<usize>,
    /// The nodes in the order of elimination.
    pub order: Vec<usize>,
    pub pattern: SymbolicSparseColMat<usize>,
    pub symbolic: supernodal::SymbolicSupernodalCholesky<usize>,
    /// For each edge, the offset in its block column of the block of its two nodes; of no use where one is held.
    blocks: Vec<usize>,
}

impl Structure {
    /// Analyses the pattern of edges `(from, to)` between nodes of which those with `is_free` move.
    pub fn new(edges: impl Iterator<Item = (usize, usize)> + Clone, is_free: &[bool]) -> Result<Self, OutOfMemory> {
        let (place, order) = eliminate(edges.clone(), is_free)?;
        let count = order.len();
        let mut pairs: Vec<(usize, usize)> = edges.clone().filter_map(|edge| below_diagonal(&place, edge)).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let mut first = vec![0; count + 1];
        pairs.iter().for_each(|(column, _)| first[column + 1] += 1);
        (0..count).for_each(|column| first[column + 1] += first[column]);
        let block = |edge: (usize, usize)| {
            let Some(pair) = below_diagonal(&place, edge) else { return 0 };
            let column = &pairs[first[pair.0]..first[pair.0 + 1]];
            column.partition_point(|other| *other < pair)
        };
        let blocks = edges.map(block).collect();
        let (column_starts, rows) = lower_pattern(count, &pairs, &first);
        let symbolic = analyse(count, &pairs)?;
        let unknowns = count * SIZE;
        let pattern = SymbolicSparseColMat::new_checked(unknowns, unknowns, column_starts, None, rows);
        Ok(Self { place, order, pattern, symbolic, blocks })
    }

    /// The number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.order.len() * SIZE
    }

    /// Adds an edge's share to the values of H and to the gradient; `edge` counts the edges given to [`Self::new`].
    pub fn add(&self, edge: usize, ends: (usize, usize), terms: &Terms, values: &mut [f64], gradient: &mut [f64]) {
        let (from, to) = (self.place[ends.0], self.place[ends.1]);
        if from != HELD {
            self.add_diagonal(from, &terms.from_from, values);
            add_vector(&mut gradient[from * SIZE..], &terms.gradient_from);
        }
        if to != HELD {
            self.add_diagonal(to, &terms.to_to, values);
            add_vector(&mut gradient[to * SIZE..], &terms.gradient_to);
        }
        if from != HELD && to != HELD {
            let block = self.blocks[edge];
            // H's block (row of the later, column of the earlier).
            if from < to {
                self.add_block(from, block, &terms.from_to.transpose(), values);
            } else {
                self.add_block(to, block, &terms.from_to, values);
            }
        }
    }

    fn add_diagonal(&self, place: usize, block: &Matrix6<f64>, values: &mut [f64]) {
        for j in 0..SIZE {
            let start = self.pattern.col_ptr()[place * SIZE + j];
            for (i, value) in (j..SIZE).zip(&mut values[start..]) {
                *value += block[(i, j)];
            }
        }
    }

    fn add_block(&self, column: usize, offset: usize, block: &Matrix6<f64>, values: &mut [f64]) {
        for j in 0..SIZE {
            let start = self.pattern.col_ptr()[column * SIZE + j] + (SIZE - j) + offset * SIZE;
            for (i, value) in (0..SIZE).zip(&mut values[start..]) {
                *value += block[(i, j)];
            }
        }
    }
}

fn add_vector(values: &mut [f64], terms: &Vector6<f64>) {
    values.iter_mut().zip(terms.iter()).for_each(|(value, term)| *value += term);
}

/// Column and row of the block of an edge, if both its nodes move.
fn below_diagonal(place: &[usize], (from, to): (usize, usize)) -> Option<(usize, usize)> {
    let (from, to) = (place[from], place[to]);
    (from != HELD && to != HELD).then(|| (from.min(to), from.max(to)))
}

/// The places of the nodes in an order of elimination with little fill (approximate minimum degree, Amestoy, Davis and
/// Duff 1996), found on nodes instead of unknowns: 36 times less to look at, and each node's unknowns stay together.
fn eliminate(
    edges: impl Iterator<Item = (usize, usize)>,
    is_free: &[bool],
) -> Result<(Vec<usize>, Vec<usize>), OutOfMemory> {
    let free: Vec<usize> = (0..is_free.len()).filter(|node| is_free[*node]).collect();
    let mut place = vec![HELD; is_free.len()];
    free.iter().enumerate().for_each(|(index, node)| place[*node] = index);
    let mut pairs: Vec<(usize, usize)> = edges.filter_map(|edge| below_diagonal(&place, edge)).collect();
    pairs.sort_unstable();
    pairs.dedup();
    let count = free.len();
    let mut starts = vec![0; count + 1];
    pairs.iter().for_each(|(column, _)| starts[column + 1] += 1);
    (0..count).for_each(|column| starts[column + 1] += starts[column]);
    let rows: Vec<usize> = pairs.iter().map(|(_, row)| *row).collect();
    let pattern = SymbolicSparseColMatRef::new_checked(count, count, &starts, None, &rows);
    let (mut forward, mut inverse) = (vec![0_usize; count], vec![0_usize; count]);
    let mut memory = allocate(amd::order_scratch::<usize>(count, rows.len()))?;
    let stack = MemStack::new(&mut memory);
    amd::order(&mut forward, &mut inverse, pattern, amd::Control::default(), stack).map_err(|_| OutOfMemory)?;
    free.iter().zip(&inverse).for_each(|(node, rank)| place[*node] = *rank);
    Ok((place, forward.iter().map(|index| free[*index]).collect()))
}

/// Column starts and rows of the lower triangle from its off-diagonal blocks, sorted by column.
fn lower_pattern(count: usize, pairs: &[(usize, usize)], first: &[usize]) -> (Vec<usize>, Vec<usize>) {
    let mut starts = Vec::with_capacity(count * SIZE + 1);
    let mut rows = Vec::with_capacity(count * SIZE * (SIZE + 1) / 2 + pairs.len() * SIZE * SIZE);
    starts.push(0);
    for column in 0..count {
        for j in 0..SIZE {
            rows.extend((j..SIZE).map(|i| column * SIZE + i));
            for (_, row) in &pairs[first[column]..first[column + 1]] {
                rows.extend((0..SIZE).map(|i| row * SIZE + i));
            }
            starts.push(rows.len());
        }
    }
    (starts, rows)
}

/// The symbolic factorisation. It wants the upper triangle.
fn analyse(
    count: usize,
    pairs: &[(usize, usize)],
) -> Result<supernodal::SymbolicSupernodalCholesky<usize>, OutOfMemory> {
    let mut upper: Vec<(usize, usize)> = pairs.iter().map(|(column, row)| (*row, *column)).collect();
    upper.sort_unstable();
    let unknowns = count * SIZE;
    let mut starts = Vec::with_capacity(unknowns + 1);
    let mut rows = Vec::with_capacity(count * SIZE * (SIZE + 1) / 2 + pairs.len() * SIZE * SIZE);
    starts.push(0);
    let mut rest = upper.as_slice();
    for column in 0..count {
        let (own, others) = rest.split_at(rest.partition_point(|(c, _)| *c == column));
        rest = others;
        for j in 0..SIZE {
            for (_, row) in own {
                rows.extend((0..SIZE).map(|i| row * SIZE + i));
            }
            rows.extend((0..=j).map(|i| column * SIZE + i));
            starts.push(rows.len());
        }
    }
    let pattern = SymbolicSparseColMatRef::new_checked(unknowns, unknowns, &starts, None, &rows);
    let mut memory = allocate(StackReq::any_of(&[
        simplicial::prefactorize_symbolic_cholesky_scratch::<usize>(unknowns, rows.len()),
        supernodal::factorize_supernodal_symbolic_cholesky_scratch::<usize>(unknowns),
    ]))?;
    let (mut parents, mut counts) = (vec![0_isize; unknowns], vec![0_usize; unknowns]);
    let tree =
        simplicial::prefactorize_symbolic_cholesky(&mut parents, &mut counts, pattern, MemStack::new(&mut memory));
    let parameters = Default::default();
    let stack = MemStack::new(&mut memory);
    supernodal::factorize_supernodal_symbolic_cholesky(pattern, tree, &counts, stack, parameters)
        .map_err(|_| OutOfMemory)
}

/// Working memory for faer.
pub(super) fn allocate(request: StackReq) -> Result<MemBuffer, OutOfMemory> {
    MemBuffer::try_new(request).map_err(|_| OutOfMemory)
}
