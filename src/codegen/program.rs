//! One algorithm of one scene as a program of scalar operations, without anything that this scene does not need.

use crate::dynamics::sweeps::{self, InverseColumns, MassColumns, SweepModel, SweepScratch};
use crate::error::Error;
use crate::scalar::{Operation, Traced};
use crate::scene::Scene;

/// What a program can compute.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Function {
    /// qdd of (q, qd, tau), in covariance form.
    ForwardDynamics,
    /// tau of (q, qd, qdd).
    InverseDynamics,
    /// The torque of the bias, of (q, qd).
    BiasTorque,
    /// M of q, row by row.
    MassMatrix,
    /// M^-1 of q, row by row, in covariance form.
    MassMatrixInverse,
}

/// All of them.
pub const FUNCTIONS: [Function; 5] = [
    Function::ForwardDynamics,
    Function::InverseDynamics,
    Function::BiasTorque,
    Function::MassMatrix,
    Function::MassMatrixInverse,
];

impl Function {
    /// Its name, as the methods of scenes have it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::ForwardDynamics => "forward_dynamics",
            Self::InverseDynamics => "inverse_dynamics",
            Self::BiasTorque => "bias_torque",
            Self::MassMatrix => "mass_matrix",
            Self::MassMatrixInverse => "mass_matrix_inverse",
        }
    }

    /// Its arguments.
    #[must_use]
    pub fn arguments(self) -> &'static [&'static str] {
        match self {
            Self::ForwardDynamics => &["q", "qd", "tau"],
            Self::InverseDynamics => &["q", "qd", "qdd"],
            Self::BiasTorque => &["q", "qd"],
            Self::MassMatrix | Self::MassMatrixInverse => &["q"],
        }
    }

    /// What its result is called.
    #[must_use]
    pub fn result(self) -> &'static str {
        match self {
            Self::ForwardDynamics => "qdd",
            Self::InverseDynamics | Self::BiasTorque => "tau",
            Self::MassMatrix => "mass",
            Self::MassMatrixInverse => "inverse",
        }
    }

    /// How many numbers it gives for `nv` degrees of freedom.
    #[must_use]
    pub fn width(self, nv: usize) -> usize {
        if matches!(self, Self::MassMatrix | Self::MassMatrixInverse) { nv * nv } else { nv }
    }
}

/// Operations in order, each of those before it; arguments are numbered through, q first.
#[derive(Debug, Clone)]
pub struct Program {
    /// What it computes.
    pub function: Function,
    /// Coordinates and degrees of freedom of the scene.
    pub sizes: (usize, usize),
    pub(super) operations: Vec<Operation>,
    /// The places of the results.
    pub(super) results: Vec<u32>,
}

/// How many operations of a kind a program has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Size {
    /// Sums and differences.
    pub sums: usize,
    /// Products that nothing is added to.
    pub products: usize,
    /// Products with a sum.
    pub fused: usize,
    /// Quotients and square roots.
    pub quotients: usize,
    /// Sines and cosines.
    pub sines: usize,
}

impl Program {
    /// The program of one function of `scene`.
    ///
    /// The sweeps run once on numbers that remember what they come of ([`Traced`]). O(N) operations for the dynamics, O(N^2) for matrices.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for a scene with connections, with joints that follow others, or whose inverse mass matrix is not multiplied out (chains of more than 300 joints).
    pub fn new(scene: &Scene, function: Function) -> Result<Self, Error> {
        check(scene, function)?;
        let sizes = (scene.nq(), scene.nv());
        let (results, operations) = Traced::during(|| trace(scene, function));
        let results = results.iter().map(|result| result.place()).collect();
        Ok(Self { function, sizes, operations, results }.without_dead_ends())
    }

    /// The same without operations that no result needs.
    fn without_dead_ends(self) -> Self {
        let mut is_needed = vec![false; self.operations.len()];
        for &result in &self.results {
            is_needed[result as usize] = true;
        }
        for (place, operation) in self.operations.iter().enumerate().rev() {
            if is_needed[place] {
                for of in operands(operation).into_iter().flatten() {
                    is_needed[of as usize] = true;
                }
            }
        }
        let mut moved = vec![0; self.operations.len()];
        let mut operations = Vec::new();
        for (place, operation) in self.operations.iter().enumerate().filter(|&(place, _)| is_needed[place]) {
            moved[place] = u32::try_from(operations.len()).unwrap_or(u32::MAX);
            operations.push(renumbered(operation, &moved));
        }
        let results = self.results.iter().map(|&result| moved[result as usize]).collect();
        Self { operations, results, ..self }
    }

    /// The results at these arguments, (q, then what else the function takes): what the program means, slowly.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] for another number of arguments.
    pub fn run(&self, arguments: &[f64]) -> Result<Vec<f64>, Error> {
        let (nq, nv) = self.sizes;
        let count = nq + (self.function.arguments().len() - 1) * nv;
        crate::error::check_length("arguments", arguments.len(), count)?;
        let mut values: Vec<f64> = Vec::with_capacity(self.operations.len());
        for operation in &self.operations {
            let of = |place: u32| values[place as usize];
            let value = match *operation {
                Operation::Constant(bits) => f64::from_bits(bits),
                Operation::Argument(index) => arguments[index as usize],
                Operation::Sum(a, b) => of(a) + of(b),
                Operation::Difference(a, b) => of(a) - of(b),
                Operation::Product(a, b) => of(a) * of(b),
                Operation::ProductSum(a, b, c) => of(a) * of(b) + of(c),
                Operation::MinusProduct(a, b, c) => of(c) - of(a) * of(b),
                Operation::Quotient(a, b) => of(a) / of(b),
                Operation::Negative(a) => -of(a),
                Operation::Root(a) => of(a).sqrt(),
                Operation::Sine(a) => of(a).sin(),
                Operation::Cosine(a) => of(a).cos(),
                Operation::Absolute(a) => of(a).abs(),
                Operation::Smaller(a, b) => crate::scalar::Real::worst(of(a), of(b)),
                Operation::OneIfZero(a) => f64::from(u8::from(of(a) == 0.0)),
            };
            values.push(value);
        }
        Ok(self.results.iter().map(|&result| values[result as usize]).collect())
    }

    /// How many operations it has.
    #[must_use]
    pub fn size(&self) -> Size {
        let mut size = Size::default();
        for operation in &self.operations {
            match operation {
                Operation::Sum(..) | Operation::Difference(..) => size.sums += 1,
                Operation::Product(..) => size.products += 1,
                Operation::ProductSum(..) | Operation::MinusProduct(..) => size.fused += 1,
                Operation::Quotient(..) | Operation::Root(_) => size.quotients += 1,
                Operation::Sine(_) | Operation::Cosine(_) => size.sines += 1,
                _ => {}
            }
        }
        size
    }
}

fn check(scene: &Scene, function: Function) -> Result<(), Error> {
    scene.check_no_connections("scene")?;
    if scene.coupling().is_some() {
        let found = "a scene whose joints follow each other (mimic=\"couple\")";
        return Err(Error::argument("scene", found, "independent joints: mimic=\"free\""));
    }
    if function == Function::MassMatrixInverse && !SweepModel::<f64>::new(scene.model()).is_shallow() {
        let found = format!("a scene of {} degrees of freedom in long chains", scene.nv());
        return Err(Error::argument("functions", found, "mass_matrix_inverse of shorter ones, or forward_dynamics"));
    }
    Ok(())
}

/// The results, written by the sweeps; in this thread's program.
fn trace(scene: &Scene, function: Function) -> Vec<Traced> {
    let model = scene.model();
    let (sweeps, model) = (SweepModel::<Traced>::new(model), model.cast::<Traced>());
    let mut scratch = SweepScratch::new(&model, &sweeps);
    let (nq, nv) = (model.nq, model.nv());
    let mut next = 0;
    let mut arguments = |count: usize| -> Vec<Traced> {
        let first = next;
        next += count;
        (first..next).map(|index| Traced::argument(u32::try_from(index).unwrap_or(u32::MAX))).collect()
    };
    let q = arguments(nq);
    let (mut qd, mut u) = (Vec::new(), Vec::new());
    if function.arguments().len() > 1 {
        qd = arguments(nv);
    }
    if function.arguments().len() > 2 {
        u = arguments(nv);
    }
    let scene = (&model, &sweeps);
    let mut out = vec![Traced::argument(0); function.width(nv)];
    match function {
        Function::ForwardDynamics => {
            sweeps::forward_dynamics::<Traced, Traced>(scene, &mut scratch, (&q, &qd, &u), &[], &mut out);
        }
        Function::InverseDynamics => {
            sweeps::inverse_dynamics::<Traced, Traced>(scene, &mut scratch, (&q, &qd, Some(&u)), &[], &mut out);
        }
        Function::BiasTorque => {
            sweeps::inverse_dynamics::<Traced, Traced>(scene, &mut scratch, (&q, &qd, None), &[], &mut out);
        }
        Function::MassMatrix => {
            let mut columns: MassColumns<Traced, Traced> = MassColumns::new();
            columns.prepare(&model, &sweeps);
            sweeps::mass_matrix::<Traced, Traced, false>(scene, (&mut scratch, &mut columns), &q, &mut out);
        }
        Function::MassMatrixInverse => {
            let mut columns: InverseColumns<Traced, Traced> = InverseColumns::new();
            columns.prepare(&model, &sweeps);
            sweeps::factor::<Traced, Traced>(scene, &mut scratch, &q);
            sweeps::multiplied_out::<Traced, Traced, false>(scene, &scratch, &mut columns, &mut out);
        }
    }
    out
}

/// What an operation reads.
pub(super) fn operands(operation: &Operation) -> [Option<u32>; 3] {
    match *operation {
        Operation::Constant(_) | Operation::Argument(_) => [None; 3],
        Operation::Sum(a, b)
        | Operation::Difference(a, b)
        | Operation::Product(a, b)
        | Operation::Quotient(a, b)
        | Operation::Smaller(a, b) => [Some(a), Some(b), None],
        Operation::ProductSum(a, b, c) | Operation::MinusProduct(a, b, c) => [Some(a), Some(b), Some(c)],
        Operation::Negative(a)
        | Operation::Root(a)
        | Operation::Sine(a)
        | Operation::Cosine(a)
        | Operation::Absolute(a)
        | Operation::OneIfZero(a) => [Some(a), None, None],
    }
}

fn renumbered(operation: &Operation, moved: &[u32]) -> Operation {
    let to = |place: u32| moved[place as usize];
    match *operation {
        Operation::Constant(_) | Operation::Argument(_) => *operation,
        Operation::Sum(a, b) => Operation::Sum(to(a), to(b)),
        Operation::Difference(a, b) => Operation::Difference(to(a), to(b)),
        Operation::Product(a, b) => Operation::Product(to(a), to(b)),
        Operation::ProductSum(a, b, c) => Operation::ProductSum(to(a), to(b), to(c)),
        Operation::MinusProduct(a, b, c) => Operation::MinusProduct(to(a), to(b), to(c)),
        Operation::Quotient(a, b) => Operation::Quotient(to(a), to(b)),
        Operation::Negative(a) => Operation::Negative(to(a)),
        Operation::Root(a) => Operation::Root(to(a)),
        Operation::Sine(a) => Operation::Sine(to(a)),
        Operation::Cosine(a) => Operation::Cosine(to(a)),
        Operation::Absolute(a) => Operation::Absolute(to(a)),
        Operation::Smaller(a, b) => Operation::Smaller(to(a), to(b)),
        Operation::OneIfZero(a) => Operation::OneIfZero(to(a)),
    }
}
