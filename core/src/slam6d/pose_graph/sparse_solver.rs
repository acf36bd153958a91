//! Solves the normal equations by sparse Cholesky factorisation.

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::sparse::SparseColMatRef;
use faer::sparse::linalg::cholesky::supernodal;
use faer::{Conj, MatMut, Par};

use super::linearisation::Terms;
use super::structure::{OutOfMemory, SIZE, Structure, allocate};

/// The numbers that belong to a [`Structure`]; they are reused from iteration to iteration and from call to call.
pub(super) struct SparseSolver {
    pub structure: Structure,
    /// The lower triangle of H.
    pub values: Vec<f64>,
    /// The gradient, in the order of elimination.
    pub gradient: Vec<f64>,
    /// The last solution, in the order of elimination.
    pub step: Vec<f64>,
    factor: Vec<f64>,
    damped: Vec<f64>,
    memory: MemBuffer,
    /// The factor is that of the present undamped H.
    is_exact: bool,
}

impl SparseSolver {
    pub fn new(structure: Structure) -> Result<Self, OutOfMemory> {
        let symbolic = &structure.symbolic;
        let memory = allocate(StackReq::any_of(&[
            supernodal::factorize_supernodal_numeric_llt_scratch::<usize, f64>(symbolic, Par::Seq, Default::default()),
            symbolic.solve_in_place_scratch::<f64>(1, Par::Seq),
        ]))?;
        let unknowns = structure.unknowns();
        Ok(Self {
            values: vec![0.0; structure.pattern.row_idx().len()],
            damped: vec![0.0; structure.pattern.row_idx().len()],
            gradient: vec![0.0; unknowns],
            step: vec![0.0; unknowns],
            factor: vec![0.0; symbolic.len_val()],
            memory,
            is_exact: false,
            structure,
        })
    }

    /// Forgets the sums.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
        self.gradient.fill(0.0);
        self.is_exact = false;
    }

    /// Adds the share of an edge.
    pub fn add(&mut self, edge: usize, ends: (usize, usize), terms: &Terms) {
        self.structure.add(edge, ends, terms, &mut self.values, &mut self.gradient);
    }

    /// Solves (H + damping diag(H)) step = -gradient. `false` when the matrix is not positive definite.
    pub fn solve(&mut self, damping: f64) -> bool {
        if !self.factorise(damping) {
            return false;
        }
        self.step.iter_mut().zip(&self.gradient).for_each(|(step, gradient)| *step = -gradient);
        let unknowns = self.step.len();
        let right = MatMut::from_column_major_slice_mut(&mut self.step, unknowns, 1);
        let factor = supernodal::SupernodalLltRef::new(&self.structure.symbolic, &self.factor);
        factor.solve_in_place_with_conj(Conj::No, right, Par::Seq, MemStack::new(&mut self.memory));
        self.step.iter().all(|value| value.is_finite())
    }

    /// Factorises H + damping diag(H).
    pub(super) fn factorise(&mut self, damping: f64) -> bool {
        let structure = &self.structure;
        self.damped.copy_from_slice(&self.values);
        if damping > 0.0 {
            // The first entry of a column of the lower triangle is its diagonal.
            let diagonal = &structure.pattern.col_ptr()[..structure.unknowns()];
            // A direction that no edge measures has none, and must be held as well.
            let least = 1e-9 * diagonal.iter().map(|start| self.values[*start]).fold(1e-300, f64::max);
            for start in diagonal {
                self.damped[*start] += damping * self.values[*start].max(least);
            }
        }
        let result = supernodal::factorize_supernodal_numeric_llt(
            &mut self.factor,
            SparseColMatRef::new(structure.pattern.as_ref(), self.damped.as_slice()),
            LltRegularization::default(),
            &structure.symbolic,
            Par::Seq,
            MemStack::new(&mut self.memory),
            Default::default(),
        );
        self.is_exact = result.is_ok() && damping == 0.0;
        result.is_ok()
    }

    /// Makes sure that the factor is that of H itself; `false` when H is not positive definite.
    pub fn factorise_exactly(&mut self) -> bool {
        self.is_exact || self.factorise(0.0)
    }

    /// G^T H^-1 G for a G of six columns given by the blocks of a few nodes, by the factor of the last solution: with
    /// L x = G it is x^T x, and x only differs from zero on the way from those nodes to the root of the elimination.
    pub fn project(&self, blocks: &[(usize, nalgebra::Matrix6<f64>)]) -> nalgebra::Matrix6<f64> {
        let unknowns = self.structure.unknowns();
        let mut x = vec![0.0; unknowns * SIZE];
        let mut first = unknowns;
        for (node, block) in blocks {
            let place = self.structure.place[*node];
            if place != super::structure::HELD {
                first = first.min(place * SIZE);
                for (i, j) in (0..SIZE).flat_map(|j| (0..SIZE).map(move |i| (i, j))) {
                    x[j * unknowns + place * SIZE + i] += block[(i, j)];
                }
            }
        }
        let factor = supernodal::SupernodalLltRef::new(&self.structure.symbolic, &self.factor);
        let mut result = nalgebra::Matrix6::zeros();
        let begin = self.structure.symbolic.supernode_end().partition_point(|end| *end <= first);
        for s in begin..self.structure.symbolic.n_supernodes() {
            let supernode = factor.supernode(s);
            let (matrix, start) = (supernode.val(), supernode.start());
            let size = matrix.ncols();
            let rows = start..start + size;
            if (0..SIZE).all(|j| x[j * unknowns..][rows.clone()].iter().all(|value| *value == 0.0)) {
                continue;
            }
            let (diagonal, below) = matrix.split_at_row(size);
            let mut right = MatMut::from_column_major_slice_mut(&mut x, unknowns, SIZE);
            solve_lower_triangular_in_place(diagonal, right.as_mut().subrows_mut(start, size), Par::Seq);
            for j in 0..SIZE {
                for (k, value) in x[j * unknowns..][rows.clone()].to_vec().into_iter().enumerate() {
                    for (row, entry) in supernode.pattern().iter().zip(below.col(k).iter()) {
                        x[j * unknowns + row] -= entry * value;
                    }
                }
            }
            for (i, j) in (0..SIZE).flat_map(|j| (0..=j).map(move |i| (i, j))) {
                let (a, b) = (&x[i * unknowns..][rows.clone()], &x[j * unknowns..][rows.clone()]);
                result[(i, j)] += a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            }
        }
        result.fill_lower_triangle_with_upper_triangle();
        result
    }
}
