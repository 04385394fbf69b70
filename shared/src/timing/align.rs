//! Alignment by the templates of the package.
