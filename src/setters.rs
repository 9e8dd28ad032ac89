//! Setters in builder style, for structs whose fields are public and which can gain fields.

/// `setters!(Type { with_field: field: Value })` implements consuming setters; `field => Value` accepts every type that
/// converts to `Value`.
macro_rules! setters {
    ($type:ident $(<$lifetime:lifetime>)? {
        $($setter:ident: $field:ident $(: $value:ty)? $(=> $into:ty)?),+ $(,)?
    }) => {
        impl $(<$lifetime>)? $type $(<$lifetime>)? {
            $(
                $crate::setters::setter!($setter: $field $(: $value)? $(=> $into)?);
            )+
        }
    };
}

macro_rules! setter {
    ($setter:ident: $field:ident: $value:ty) => {
        #[doc = concat!("The same with another [`", stringify!($field), "`](Self::", stringify!($field), ").")]
        #[must_use]
        pub fn $setter(mut self, $field: $value) -> Self {
            self.$field = $field;
            self
        }
    };
    ($setter:ident: $field:ident => $value:ty) => {
        #[doc = concat!("The same with another [`", stringify!($field), "`](Self::", stringify!($field), ").")]
        #[must_use]
        pub fn $setter(mut self, $field: impl Into<$value>) -> Self {
            self.$field = $field.into();
            self
        }
    };
}
pub(crate) use {setter, setters};
