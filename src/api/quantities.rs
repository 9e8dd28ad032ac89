//! Kinematic quantities of one state, with arguments checked and faults named.

use crate::algorithm::{Arguments, KinematicQuantity};
use crate::dynamics::quantities::{of_all_bodies, of_frame};
use crate::error::{Error, check_length};
use crate::scene::Scene;
use crate::workspace::Workspace;
use std::borrow::Cow;

impl Scene {
    /// A kinematic quantity at one state (q, qd, qdd), of which it reads [`KinematicQuantity::reads`] arrays, into
    /// `out`: the result of the method of the same name.
    ///
    /// # Errors
    ///
    /// As that method; a result of another length.
    pub fn kinematic_quantity(
        &self,
        workspace: &mut Workspace<f64>,
        what: &KinematicQuantity<'_>,
        state: [&[f64]; 3],
        out: &mut [f64],
    ) -> Result<(), Error> {
        self.quantity(Some(workspace), what, &state, out)
    }

    /// The same for a state that can have its own model.
    #[cold]
    pub(crate) fn quantity_of_model(
        &self,
        workspace: &mut Workspace<f64>,
        what: &KinematicQuantity<'_>,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let given = [state.q, state.qd, state.u];
        if state.model.is_of_scene() {
            return self.kinematic_quantity(workspace, what, given, out);
        }
        let own = self.with_state_model(&state.model)?;
        own.kinematic_quantity(&mut own.workspace(), what, given, out)
    }

    /// [`Scene::kinematic_quantity`] without the arrays that it does not read; quantities of frames need no workspace.
    pub(super) fn quantity(
        &self,
        workspace: Option<&mut Workspace<f64>>,
        what: &KinematicQuantity<'_>,
        given: &[&[f64]],
        out: &mut [f64],
    ) -> Result<(), Error> {
        check_length("out", out.len(), what.width(self.nv()))?;
        match (what.frame(), &workspace) {
            (Some(frame), _) => self.check_frame(frame)?,
            (None, Some(workspace)) => self.check_workspace(workspace)?,
            (None, None) => {}
        }
        if what.entry().needs_mass {
            self.check_has_mass()?;
        }
        let rates = |place: usize, name: &str| {
            if place < what.reads() { self.tree_rates(name, given[place]) } else { Ok(Cow::Borrowed(&[][..])) }
        };
        let (q, qd, qdd) = (self.tree_configuration("q", given[0])?, rates(1, "qd")?, rates(2, "qdd")?);
        let (model, state) = (self.model(), (&*q, &*qd, &*qdd));
        let compute = |out: &mut [f64]| {
            if !of_frame(model, what, state, out)
                && let Some(workspace) = workspace
            {
                of_all_bodies(model, workspace, what, state, out);
            }
        };
        // Without a row or column per degree of freedom the result is that of the tree.
        match self.coupling().filter(|_| what.width(model.nv()) != out.len()) {
            Some(coupling) => {
                let mut of_tree = vec![f64::NAN; what.width(model.nv())];
                compute(&mut of_tree);
                coupling.reduce_quantity(what, &of_tree, out);
            }
            None => compute(out),
        }
        if out.iter().all(|value| value.is_finite()) {
            return Ok(());
        }
        self.check_result(&what.entry().name.replace('_', " "), out)
    }

    /// [`Scene::quantity`] as an array of the length of its result.
    pub(super) fn numbers_of<const N: usize>(
        &self,
        workspace: Option<&mut Workspace<f64>>,
        what: &KinematicQuantity<'_>,
        given: &[&[f64]],
    ) -> Result<[f64; N], Error> {
        let mut out = [f64::NAN; N];
        self.quantity(workspace, what, given, &mut out)?;
        Ok(out)
    }
}
