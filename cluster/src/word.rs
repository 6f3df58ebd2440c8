//! What an exchange carries.

/// A word of an exchange: 32 bits that can be added.
pub trait Word: Copy + Send + Sync + Default + 'static {
    /// The sum. For integers it cannot overflow, because senders keep to a proven bound.
    fn add(self, other: Self) -> Self;
}

impl Word for i32 {
    fn add(self, other: Self) -> Self {
        self + other
    }
}

impl Word for f32 {
    fn add(self, other: Self) -> Self {
        self + other
    }
}
