import subprocess

from hydro_twin.recording.digest import source_of


def test_digests_are_those_of_sha256sum(tmp_path):
    bag = tmp_path / 'bag'
    bag.mkdir()
    (bag / 'b.mcap').write_bytes(b'x' * 3_000_000)
    (bag / 'a.yaml').write_text('a: 1')
    one = subprocess.run(['sha256sum', bag / 'b.mcap'], capture_output=True, check=True, text=True)
    assert source_of(bag / 'b.mcap').sha256 == one.stdout.split()[0]
    all_ = subprocess.run(f'cd {bag} && sha256sum * | sha256sum', shell=True, capture_output=True,
                          check=True, text=True)
    assert source_of(bag).sha256 == all_.stdout.split()[0]
    assert source_of(bag).path == str(bag)
