use std::fmt;
use std::sync::Arc;

use srflow_core::Recent;

use crate::{Avatar, AvatarError, HeadSource};

/// Avatars that are made once for those who need the same ones, such as two datasets of the same subjects: a head takes seconds.
pub struct Avatars(Recent<(HeadSource, u64), Avatar>);

impl Avatars {
    /// Keeps the `count` avatars that were asked for last, besides those in use.
    pub fn keeping(count: usize) -> Self {
        Self(Recent::new(count))
    }

    /// The avatar of [`HeadSource::avatar`]. Others that ask for it while it is made wait; other avatars can be made meanwhile.
    ///
    /// # Errors
    /// Those of [`HeadSource::avatar`]; a head that could not be read is read again when it is asked for again.
    pub fn get(&self, head: &HeadSource, seed: u64) -> Result<Arc<Avatar>, AvatarError> {
        self.0.get((head.clone(), seed), || head.avatar(seed))
    }
}

impl fmt::Debug for Avatars {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Avatars").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_avatar_is_made_once_for_all_who_need_it() {
        let (avatars, head) = (Avatars::keeping(2), HeadSource::builtin());
        let [one, same, other] = [3, 3, 4].map(|seed| avatars.get(&head, seed).unwrap());
        assert!(Arc::ptr_eq(&one, &same) && !Arc::ptr_eq(&one, &other));
        let alone = head.avatar(3).unwrap();
        assert_eq!(one.shaped().vertices, alone.shaped().vertices);
    }
}
