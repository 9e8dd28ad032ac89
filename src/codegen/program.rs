//! One algorithm of one scene as a program of scalar operations, without operations that this scene does not need.

use super::coupled;
use super::functions::{Array, Function};
use super::tracing::Tracer;
use super::width::Width;
use crate::dynamics::sweeps::SweepModel;
use crate::error::Error;
use crate::model::Model;
use crate::scalar::{Operation, Operations, Real, Traced};
use crate::scene::{Coupling, Scene};
use std::collections::HashSet;

/// Operations in order; the operands of each precede it. Arguments are numbered consecutively, q first.
#[derive(Debug, Clone)]
pub struct Program {
    /// The function.
    pub function: Function,
    /// The arguments, q first.
    pub arguments: Vec<Array>,
    /// The results.
    pub results: Vec<Array>,
    /// The indices in q at which quaternions begin.
    pub(super) quaternions: Vec<usize>,
    pub(super) operations: Vec<Operation>,
    /// The indices of the values of all results, one after another.
    places: Vec<u32>,
}

impl Program {
    /// The program of one function of `scene`.
    ///
    /// The sweeps run once on a scalar that records its operations ([`Traced`]). The program keeps the order of the
    /// sweeps, joint by joint, which stores fewer intermediate values than an order backward from the results. O(N)
    /// operations for the dynamics, O(N^2) for matrices.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for derivatives of forward dynamics of a scene with connections, for constrained dynamics of
    /// a scene without, for a scene whose inverse mass matrix is not a product of factors (chains of more than 300
    /// joints), for constants that overflow, and for an unknown link.
    pub fn new(scene: &Scene, function: &Function) -> Result<Self, Error> {
        Self::accepting(scene, function, None)
    }

    /// [`Program::new`] with another tolerance for the margin than the default (see
    /// [`Workspace::tolerance`](crate::Workspace::tolerance)).
    ///
    /// # Errors
    ///
    /// As [`Program::new`].
    pub fn accepting(scene: &Scene, function: &Function, tolerance: Option<f64>) -> Result<Self, Error> {
        check(scene, function)?;
        let place = function.place(scene)?;
        let (arguments, results) = (function.arguments(scene), function.results(scene));
        let (places, operations) = Traced::during(|| {
            let mut next = 0..;
            let mut given = Vec::new();
            for argument in &arguments {
                given.push(next.by_ref().take(argument.width()).map(Traced::argument).collect());
            }
            let mut out = vec![Traced::argument(0); results.iter().map(Array::width).sum()];
            let of_tree = scene.coupling().map_or(scene, Coupling::tied);
            let mut tracer = Tracer::new(of_tree, of_tree.model(), place, tolerance);
            match scene.coupling() {
                Some(coupling) => coupled::trace(coupling, function, &mut tracer.with_rows(), &given, &mut out),
                None if function.has_rows(scene) => function.trace()(&mut tracer.with_rows(), &given, &mut out),
                None => function.trace()(&mut tracer, &given, &mut out),
            }
            // A constant gets its index here.
            out.iter().map(|number| number.place()).collect()
        });
        let program = Self {
            function: function.clone(),
            arguments,
            results,
            quaternions: quaternions(scene),
            operations,
            places,
        }
        .without_dead_ends();
        program.check_constants(Width::Double)?;
        Ok(program)
    }

    /// Checks that all constants are finite in code of this width.
    pub(super) fn check_constants(&self, width: Width) -> Result<(), Error> {
        for operation in &self.operations {
            let Operation::Constant(bits) = *operation else { continue };
            let value = f64::from_bits(bits);
            if width.holds(value) {
                continue;
            }
            let found = format!("a constant of {value:e} in {}", self.function.symbol());
            let expected = match width {
                Width::Single if value.is_finite() => "constants below 3.4e38; float64 holds this one",
                _ => "inertias and lengths whose products are finite",
            };
            return Err(Error::argument("scene", found, expected));
        }
        Ok(())
    }

    /// The argument of this index among the values of all arguments: its array, and the index in it.
    pub(super) fn argument(&self, index: u32) -> (&Array, usize) {
        let mut left = index as usize;
        for array in &self.arguments {
            if left < array.width() {
                return (array, left);
            }
            left -= array.width();
        }
        unreachable!("an argument that no array has")
    }

    /// The names of arguments and results, with their prefixes.
    pub(super) fn named(&self, argument: &str, result: &str) -> String {
        let arguments = self.arguments.iter().map(|array| format!("{argument}{}", array.name));
        let results = self.results.iter().map(|array| format!("{result}{}", array.name));
        arguments.chain(results).collect::<Vec<String>>().join(", ")
    }

    /// The names of arguments that nothing reads.
    pub(super) fn unread(&self) -> impl Iterator<Item = &'static str> {
        let read: HashSet<&str> = (self.operations.iter())
            .filter_map(|operation| match *operation {
                Operation::Argument(index) => Some(self.argument(index).0.name),
                _ => None,
            })
            .collect();
        self.arguments.iter().map(|array| array.name).filter(move |name| !read.contains(name))
    }

    /// The name of a result in a test: its function, and for functions with several results also its own name.
    pub(super) fn said_of(&self, result: &Array) -> String {
        let function = self.function.symbol();
        if self.results.len() > 1 { format!("{function}, {}", result.name) } else { function }
    }

    /// The results with the indices of their values.
    pub(super) fn outputs(&self) -> impl Iterator<Item = (&Array, &[u32])> {
        let mut rest = &self.places[..];
        self.results.iter().map(move |array| {
            let (own, others) = rest.split_at(array.width());
            rest = others;
            (array, own)
        })
    }

    /// Every value of the results: its array, the index in it, and its operation.
    pub(super) fn written(&self) -> impl Iterator<Item = (&Array, usize, usize)> {
        self.outputs()
            .flat_map(|(array, places)| places.iter().enumerate().map(move |(at, &place)| (array, at, place as usize)))
    }

    /// The program without operations that no result needs.
    fn without_dead_ends(self) -> Self {
        let mut is_needed = vec![false; self.operations.len()];
        for &result in &self.places {
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
            operations.push(renumbered(operation, |place| moved[place as usize]));
        }
        let places = self.places.iter().map(|&result| moved[result as usize]).collect();
        Self { operations, places, ..self }
    }

    /// The results at these arguments, one after another: a slow interpreter that defines the meaning of the program.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] for a wrong number of arguments.
    pub fn run(&self, arguments: &[f64]) -> Result<Vec<f64>, Error> {
        let count = self.arguments.iter().map(Array::width).sum();
        crate::error::check_length("arguments", arguments.len(), count)?;
        let mut values: Vec<f64> = Vec::with_capacity(self.operations.len());
        for operation in &self.operations {
            let value = match *operation {
                Operation::Constant(bits) => f64::from_bits(bits),
                Operation::Argument(index) => arguments[index as usize],
                _ => value(operation, |place| values[place as usize]),
            };
            values.push(value);
        }
        Ok(self.places.iter().map(|&result| values[result as usize]).collect())
    }

    /// Number of operations, counted as for the sweeps.
    #[must_use]
    pub fn operations(&self) -> Operations {
        let mut count = Operations::NONE;
        let mut angles = HashSet::new();
        for operation in &self.operations {
            match *operation {
                Operation::Sum(..) | Operation::Difference(..) => count.additions += 1,
                Operation::Product(..) => count.multiplications += 1,
                Operation::ProductSum(..) | Operation::MinusProduct(..) => count.fused += 1,
                Operation::Quotient(..) => count.divisions += 1,
                Operation::Root(_) => count.roots += 1,
                Operation::Sine(angle) | Operation::Cosine(angle) => {
                    count.sines += u64::from(angles.insert(angle));
                }
                _ => {}
            }
        }
        count
    }
}

/// The operations of a function's sweeps at these arguments, q first, in a model of `scene` (with other
/// simplifications, for instance): every executed operation, including those on constants alone.
pub(crate) fn count(
    scene: &Scene,
    model: &Model<f64>,
    function: &Function,
    given: &[&[f64]],
) -> Result<Operations, Error> {
    let given: Vec<Vec<Traced>> =
        given.iter().map(|array| array.iter().copied().map(Traced::from_f64).collect()).collect();
    let given = &given[..function.arguments(scene).len()];
    let mut out = vec![Traced::from_f64(f64::NAN); function.width(scene)];
    let mut tracer = Tracer::new(scene, model, function.place(scene)?, None);
    Ok(Traced::counted(|| function.trace()(&mut tracer, given, &mut out)).1)
}

/// The indices in q at which quaternions begin.
fn quaternions(scene: &Scene) -> Vec<usize> {
    let of_tree = scene.model().quaternions();
    let Some(coupling) = scene.coupling() else { return of_tree };
    // Joints with quaternions are independent.
    let place = |at: &usize| coupling.independent_coordinates_at().iter().position(|independent| independent == at);
    of_tree.iter().filter_map(place).collect()
}

fn check(scene: &Scene, function: &Function) -> Result<(), Error> {
    function.check(scene)?;
    if function.has_inverse() && scene.coupling().is_none() && !SweepModel::<f64>::new(scene.model()).is_shallow() {
        let found = format!("a scene of {} degrees of freedom in long chains", scene.nv());
        let expected = format!("{} of shorter ones, or forward_dynamics", function.name());
        return Err(Error::argument("functions", found, expected));
    }
    Ok(())
}

/// The value of an operation from its operands; NaN for constants and arguments, which have none.
pub(super) fn value(operation: &Operation, of: impl Fn(u32) -> f64) -> f64 {
    match *operation {
        Operation::Constant(_) | Operation::Argument(_) => f64::NAN,
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
    }
}

/// The operands of an operation.
pub(super) fn operands(operation: &Operation) -> [Option<u32>; 3] {
    let (mut all, mut count) = ([None; 3], 0);
    renumbered(operation, |operand| {
        (all[count], count) = (Some(operand), count + 1);
        operand
    });
    all
}

/// The same operation with other operands, which are requested in order.
pub(super) fn renumbered(operation: &Operation, mut to: impl FnMut(u32) -> u32) -> Operation {
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
