//! The state of an observer as one sequence of numbers, for pickles and copies.

use super::robot::{Belief, Record, Robot};
use super::settings::{Plan, Timing, WINDOW};
use crate::error::Error;
use std::collections::VecDeque;

/// Visits the numbers of the state in a fixed order: to read them, or to replace them.
type Visit<'a> = dyn FnMut(&mut [f64]) -> Result<(), Error> + 'a;

impl Robot {
    /// Visits the state of this robot. Counts come before the arrays whose lengths they determine.
    pub(super) fn visit(&mut self, plan: &Plan, visit: &mut Visit<'_>) -> Result<(), Error> {
        let most = [usize::MAX, WINDOW, plan.lag, plan.history, usize::from(plan.history == 0)];
        let last = usize::from(self.last.is_some());
        let mut counts = [self.steps, self.window.steps, self.pending.len(), self.history.len(), last];
        for (count, most) in counts.iter_mut().zip(most) {
            visit_count(count, visit)?;
            if *count > most {
                return Err(another());
            }
        }
        [self.steps, self.window.steps] = [counts[0], counts[1]];
        visit(std::slice::from_mut(&mut self.time))?;
        visit_records(&mut self.pending, counts[2], plan, visit)?;
        visit_records(&mut self.history, counts[3], plan, visit)?;
        let mut last: VecDeque<_> = self.last.take().into_iter().collect();
        visit_records(&mut last, counts[4], plan, visit)?;
        self.last = last.pop_front();
        self.prior.visit(visit)?;
        self.window.prior.visit(visit)?;
        visit(&mut self.window.inputs)?;
        visit_sums(&mut self.window.sums, visit)
    }
}

impl Belief {
    fn visit(&mut self, visit: &mut Visit<'_>) -> Result<(), Error> {
        [&mut self.q, &mut self.qd, &mut self.rest, &mut self.acting, &mut self.root]
            .into_iter()
            .try_for_each(|part| visit(part))
    }
}

impl Record {
    fn visit(&mut self, visit: &mut Visit<'_>) -> Result<(), Error> {
        let Self {
            tau,
            time,
            acting,
            timing: Timing { dt, torque_deviations, decay, walk },
            readings,
            rejected,
            q,
            qd,
            rest,
            noise,
            root,
            flow,
            by_wrench,
            next_q,
            next_qd,
            next_rest,
            nis,
            count,
            by_sensor,
        } = self;
        for part in [
            tau,
            acting,
            torque_deviations,
            decay,
            walk,
            readings,
            rejected,
            q,
            qd,
            rest,
            noise,
            root,
            flow,
            by_wrench,
            next_q,
            next_qd,
            next_rest,
        ] {
            visit(part)?;
        }
        for number in [time, dt, nis] {
            visit(std::slice::from_mut(number))?;
        }
        visit_count(count, visit)?;
        visit_sums(by_sensor, visit)
    }
}

fn visit_records(
    records: &mut VecDeque<Box<Record>>,
    count: usize,
    plan: &Plan,
    visit: &mut Visit<'_>,
) -> Result<(), Error> {
    records.truncate(count);
    for at in 0..count {
        if at == records.len() {
            records.push_back(Box::new(Record::new(plan)?));
        }
        records[at].visit(visit)?;
    }
    Ok(())
}

fn visit_sums(sums: &mut [(f64, usize)], visit: &mut Visit<'_>) -> Result<(), Error> {
    for (sum, count) in sums {
        visit(std::slice::from_mut(sum))?;
        visit_count(count, visit)?;
    }
    Ok(())
}

/// A count is stored as the bits of a number.
fn visit_count(count: &mut usize, visit: &mut Visit<'_>) -> Result<(), Error> {
    let mut stored = [f64::from_bits(*count as u64)];
    visit(&mut stored)?;
    *count = usize::try_from(stored[0].to_bits()).map_err(|_| another())?;
    Ok(())
}

/// The error of numbers that are not those of an observer with the same settings.
pub(super) fn another() -> Error {
    Error::argument("pickled observer", "data of another observer", "the data that pickle wrote")
}
