//! Railway crossing panel condition monitoring.
