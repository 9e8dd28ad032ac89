//! Values computed once per scene and read by all threads.

use std::any::{Any, TypeId};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Values computed for one scene, at most one of each type.
#[derive(Clone, Default)]
pub(crate) struct Shared(Arc<Mutex<HashMap<TypeId, Arc<dyn Any + Send + Sync>>>>);

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Shared")
    }
}

impl Shared {
    /// The value of type `V`; the first call computes it.
    pub fn get_or_make<V: Any + Send + Sync>(&self, make: impl FnOnce() -> V) -> Arc<V> {
        let mut values = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let value = values.entry(TypeId::of::<V>()).or_insert_with(|| Arc::new(make()));
        // The key is the type of the value, so that the downcast cannot fail.
        Arc::clone(value).downcast().unwrap_or_else(|_| unreachable!("filed under its type"))
    }
}

#[cfg(test)]
mod tests {
    use super::Shared;
    use std::sync::Arc;

    #[test]
    fn a_value_is_made_once_and_shared_by_copies() {
        let shared = Shared::default();
        let one = shared.get_or_make(|| 7_u32);
        let same = shared.clone().get_or_make(|| 8_u32);
        assert!(Arc::ptr_eq(&one, &same));
        assert_eq!((*one, *shared.get_or_make(|| 9_u64)), (7, 9));
    }
}
