pub fn top(_c: &crate::cli::Common, _o: bool, _j: bool) -> anyhow::Result<u8> {
    anyhow::bail!("x")
}
