//! What is trained: representation and augmentation of each method.

mod fields;

pub use fields::Model;
