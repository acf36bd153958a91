//! Message layouts that describe themselves.
//!
//! [`message!`](crate::layout) defines a struct whose size is asserted at compile time and which can write its own
//! description (fields, types, offsets) as JSON. The hash of that description travels as an attribute of the iceoryx2
//! service, so that two builds that disagree about a layout are told so when they meet, and recordings carry it.

use iceoryx2::prelude::ZeroCopySend;
use std::fmt::Write;

/// A type whose layout can be written down.
pub trait Layout {
    /// Appends the JSON description of the type.
    fn describe(out: &mut String);
}

/// A message part that may live in shared memory: plain data, any bit pattern valid.
pub trait Record: Layout + ZeroCopySend + bytemuck::Pod + Default + std::fmt::Debug {}

impl<T: Layout + ZeroCopySend + bytemuck::Pod + Default + std::fmt::Debug> Record for T {}

/// The JSON description of a type.
#[must_use]
pub fn description<T: Layout>() -> String {
    let mut out = String::new();
    T::describe(&mut out);
    out
}

/// The 64-bit FNV-1a hash of a description.
#[must_use]
pub fn hash(description: &str) -> u64 {
    description.bytes().fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

macro_rules! primitives {
    ($($t:ty),*) => {$(
        impl Layout for $t {
            fn describe(out: &mut String) {
                out.push_str(concat!("\"", stringify!($t), "\""));
            }
        }
    )*};
}
primitives!(u8, u16, u32, u64, i8, i16, i32, i64, f32, f64);

impl<T: Layout, const N: usize> Layout for [T; N] {
    fn describe(out: &mut String) {
        out.push_str("{\"array\":");
        T::describe(out);
        // Writing to a String cannot fail.
        let _ = write!(out, ",\"len\":{N}}}");
    }
}

/// Appends one field of a struct description; used by the `message!` macro.
#[doc(hidden)]
pub fn describe_field<T: Layout>(out: &mut String, first: bool, name: &str, offset: usize) {
    if !first {
        out.push(',');
    }
    let _ = write!(out, "{{\"name\":\"{name}\",\"offset\":{offset},\"type\":");
    T::describe(out);
    out.push('}');
}

/// Defines one part of a message: `#[repr(C)]`, plain data, no padding (bytemuck's derive refuses it), of exactly the
/// stated size, each field right behind the one before it.
macro_rules! message {
    ($(#[$meta:meta])* pub struct $name:ident: $type_name:literal, size $size:literal {
        $($(#[$field_meta:meta])* pub $field:ident: $type:ty,)*
    }) => {
        $(#[$meta])*
        #[repr(C)]
        #[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend, ::bytemuck::Pod, ::bytemuck::Zeroable)]
        #[type_name($type_name)]
        pub struct $name {
            $($(#[$field_meta])* pub $field: $type,)*
        }

        impl $crate::layout::Layout for $name {
            fn describe(out: &mut String) {
                use std::fmt::Write;
                let _ = write!(out, "{{\"struct\":\"{}\",\"size\":{},\"fields\":[", $type_name, $size);
                let mut first = true;
                $(
                    $crate::layout::describe_field::<$type>(
                        out, first, stringify!($field), std::mem::offset_of!($name, $field),
                    );
                    #[allow(unused_assignments, reason = "the last field has no successor")]
                    { first = false; }
                )*
                out.push_str("]}");
            }
        }

        impl Default for $name {
            fn default() -> Self {
                ::bytemuck::Zeroable::zeroed()
            }
        }

        const _: () = {
            assert!(std::mem::size_of::<$name>() == $size, concat!("size of ", stringify!($name), " changed"));
            let mut end = 0;
            $(
                assert!(std::mem::offset_of!($name, $field) == end, concat!("hole before ", stringify!($field)));
                end += std::mem::size_of::<$type>();
            )*
            assert!(end == $size);
        };
    };
}
pub(crate) use message;

#[cfg(test)]
mod tests {
    use super::*;

    message! {
        /// A test message.
        pub struct Sample: "mirador/test/Sample/1", size 16 {
            /// First.
            pub a: u32,
            /// Second.
            pub b: [u16; 2],
            /// Third.
            pub c: f64,
        }
    }

    #[test]
    fn a_description_names_every_field_with_type_and_offset() {
        assert_eq!(
            description::<Sample>(),
            "{\"struct\":\"mirador/test/Sample/1\",\"size\":16,\"fields\":[\
             {\"name\":\"a\",\"offset\":0,\"type\":\"u32\"},\
             {\"name\":\"b\",\"offset\":4,\"type\":{\"array\":\"u16\",\"len\":2}},\
             {\"name\":\"c\",\"offset\":8,\"type\":\"f64\"}]}"
        );
    }

    #[test]
    fn the_hash_is_fnv_1a() {
        // Reference values of the FNV-1a definition.
        assert_eq!(hash(""), 0xcbf2_9ce4_8422_2325);
        assert_eq!(hash("a"), 0xaf63_dc4c_8601_ec8c);
    }
}
