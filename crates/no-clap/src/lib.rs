//! Clap's derives for builds without clap. They accept clap's attributes and generate nothing, so that a job is one struct with
//! plain attributes whether or not the program has a command line.

use proc_macro::TokenStream;

/// Stands in for `clap::Args`.
#[proc_macro_derive(Args, attributes(arg, command, group))]
pub fn args(_: TokenStream) -> TokenStream {
    TokenStream::new()
}

/// Stands in for `clap::ValueEnum`.
#[proc_macro_derive(ValueEnum, attributes(value))]
pub fn value_enum(_: TokenStream) -> TokenStream {
    TokenStream::new()
}

/// Stands in for `clap::Subcommand`.
#[proc_macro_derive(Subcommand, attributes(command, arg))]
pub fn subcommand(_: TokenStream) -> TokenStream {
    TokenStream::new()
}
