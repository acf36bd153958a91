pub fn doctor(_c: &crate::cli::Common, _f: bool) -> anyhow::Result<u8> {
    anyhow::bail!("x")
}
