//! Setters in builder style, for structs whose fields are public and which can gain fields; and accessors of fields.

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
/// `accessors!(Type { set name(field): Value; get name(field): Value; view name(field): &Value; })` implements a
/// consuming setter, a getter that copies the field, and one that borrows it.
macro_rules! accessors {
    ($type:ident { $(
        $(#[$meta:meta])* $visible:vis $kind:ident $name:ident($field:ident): $value:ty;
    )* }) => {
        impl $type {
            $($crate::setters::accessor!($(#[$meta])* $visible $kind $name($field): $value);)*
        }
    };
}

macro_rules! accessor {
    ($(#[$meta:meta])* $visible:vis set $name:ident($field:ident): $value:ty) => {
        $(#[$meta])*
        #[must_use]
        $visible fn $name(mut self, $field: $value) -> Self {
            self.$field = $field;
            self
        }
    };
    ($(#[$meta:meta])* $visible:vis get $name:ident($field:ident): $result:ty) => {
        $(#[$meta])*
        #[must_use]
        $visible fn $name(&self) -> $result {
            self.$field
        }
    };
    ($(#[$meta:meta])* $visible:vis view $name:ident($field:ident): $result:ty) => {
        $(#[$meta])*
        #[must_use]
        $visible fn $name(&self) -> $result {
            &self.$field
        }
    };
}
pub(crate) use {accessor, accessors, setter, setters};
