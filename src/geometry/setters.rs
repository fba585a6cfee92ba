//! Setters of options, chained: `Options::new().with_this(1).with_that(2)`.
//!
//! Purpose: [`setters!`] writes one for each public field, since options that may grow cannot be written as a literal by
//! other crates. Invariant: a setter sets its field and nothing else. Must not know: any option.

/// `with_field(field: Type)` for each field; `=> value` says what the field becomes, where that is not the argument.
#[macro_export]
macro_rules! setters {
    ($($set:ident($field:ident: $of:ty $(=> $value:expr)?)),+ $(,)?) => {
        $(
            #[doc = concat!("Sets [`", stringify!($field), "`](field@Self::", stringify!($field), ").")]
            #[must_use]
            pub fn $set(mut self, $field: $of) -> Self {
                self.$field = $crate::setters!(@ $field $($value)?);
                self
            }
        )+
    };
    (@ $field:ident) => { $field };
    (@ $field:ident $value:expr) => { $value };
}
