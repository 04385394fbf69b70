//! placeholder
use crate::scoring::Score;
/// x
pub struct SiteMethods {
    /// y
    pub methods: Vec<(&'static str, Score)>,
}
/// z
pub fn site_methods() -> SiteMethods {
    SiteMethods { methods: vec![] }
}
