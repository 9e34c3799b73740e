"""What is fuzzed: every decoder of what a stranger may send, with files to damage and what must hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from random import Random

import numpy as np

from boxlift.camera import Calibration
from boxlift.errors import OptionsError
from boxlift.formats.calibration import ParsedCalibration, parse_calibration, to_kitti_text
from boxlift.formats.image import decode_image, decode_instance_ids, image_size
from boxlift.formats.json_text import parse_json
from boxlift.formats.point_cloud import decode_points
from boxlift.formats.prompts import MAX_PROMPTS, parse_prompt_lists, parse_prompts
from boxlift.formats.size_priors import parse_size_priors
from boxlift.formats.xtreme1 import parse_camera_config
from boxlift.frame import Prompt
from boxlift.settings import preset
from fuzz import bodies, seeds
from fuzz.containers import Inner, in_jpeg, in_lzf, in_npz, in_png
from fuzz.mutator import LONGEST, damaged

Container = Callable[[bytes, Random, Inner], bytes]
# Small enough that an image at the limit is decoded in some milliseconds.
MAX_PIXELS = 200_000


@dataclass(frozen=True)
class Decoder:
    """decode: returns where the data is valid, and asserts what is promised of the result; raises InputError.

    words: of the format, to write into files. container: damages what is inside of files.
    """

    decode: Callable[[bytes], None]
    seeds: tuple[bytes, ...]
    words: tuple[bytes, ...] = ()
    container: Container | None = None

    def damaged(self, data: bytes, seed: int) -> bytes:
        """Another input, made of `data`; the same for the same `seed`."""
        random = Random(seed)

        def inner(part: bytes) -> bytes:
            return damaged(part, random, self.words, self.seeds)

        if self.container is not None and random.random() < 0.6:
            return self.container(data, random, inner)[:LONGEST]
        return inner(data)


def _points(data: bytes) -> None:
    decoded = decode_points(data)
    points = decoded.points
    assert points.dtype == np.float32
    assert points.flags.writeable
    assert len(points) > 0
    assert points.shape[1] >= 3
    assert np.isfinite(points[:, :3]).all()
    assert np.abs(points[:, :3]).max() <= 1e5
    assert decoded.dropped >= 0


def _calibration(data: bytes) -> None:
    _check_calibration(parse_calibration(data))


def _camera(data: bytes) -> None:
    _check_calibration(parse_calibration(data, camera_only=True))


def _check_calibration(parsed: ParsedCalibration) -> None:
    _check_matrices(parsed.calibration)
    if parsed.image_size_px is not None:
        assert all(1 <= side <= 65_535 for side in parsed.image_size_px)


def _check_matrices(calibration: Calibration) -> None:
    assert np.isfinite(calibration.image_P_cam).all()
    assert np.isfinite(calibration.cam_SE3_velo).all()
    assert np.isfinite(calibration.camera_center_cam).all()
    pixels, _ = calibration.project(np.array([[1.0, 1.0, 20.0]]))
    assert pixels.shape == (1, 2)


def _camera_config(data: bytes) -> None:
    for parsed in parse_camera_config(data):
        if parsed is not None:
            assert to_kitti_text(parsed.calibration)
            _check_matrices(parsed.calibration)


def _prompts(data: bytes) -> None:
    _check_prompts(parse_prompts(data))


def _prompt_lists(data: bytes) -> None:
    lists = parse_prompt_lists(data, 2)
    assert len(lists) == 2
    for prompts in lists:
        _check_prompts(prompts)


def _check_prompts(prompts: tuple[Prompt, ...]) -> None:
    assert len(prompts) <= MAX_PROMPTS
    for prompt in prompts:
        assert prompt.category.encode()
        assert np.isfinite([*prompt.box_px, prompt.score]).all()


def _options(data: bytes) -> None:
    options = parse_json(data, "options", OptionsError)
    if isinstance(options, dict):
        assert preset("accurate").with_options(options).fingerprint()


def _size_priors(data: bytes) -> None:
    for size in parse_size_priors(data.decode("utf-8", "replace")).values():
        assert size.length_m > 0


def _image(data: bytes) -> None:
    image = decode_image(data, max_pixels=MAX_PIXELS)
    assert image.dtype == np.uint8
    assert image.shape[2:] == (3,)
    assert 0 < image.shape[0] * image.shape[1] <= MAX_PIXELS


def _image_size(data: bytes) -> None:
    width, height = image_size(data)
    assert 0 < width * height <= 64_000_000


def _masks(data: bytes) -> None:
    ids = decode_instance_ids(data, max_pixels=MAX_PIXELS)
    assert ids.dtype == np.uint16
    assert ids.ndim == 2
    assert 0 < ids.size <= MAX_PIXELS


_FORM_WORDS = (
    *(
        b"--a-boundary\r\n",
        b"--a-boundary--\r\n",
        b"\r\n",
        b"\r",
        b"--",
        b"Content-Disposition: form-data",
        b";",
    ),
    *(
        b'; name="points"',
        b'; name="image"',
        b'; name="calib"',
        b"; filename*=utf-8''%ff",
        b'; filename="',
        b"\\",
    ),
    *(
        b"Content-Transfer-Encoding: base64\r\n",
        b"Content-Type: multipart/mixed\r\n",
        b"boundary=",
        b": ",
        b"\x00",
    ),
)
_MSGPACK_WORDS = (
    *(
        b"\xa6points",
        b"\xa5calib",
        b"\xa5image",
        b"\xafpoints_filename",
        b"\xc4\x01a",
        b"\xc5\x00\x01a",
        b"\x80",
    ),
    *(
        b"\xc6\xff\xff\xff\xff",
        b"\xdb\xff\xff\xff\xff",
        b"\xdf\xff\xff\xff\xff",
        b"\xde\x00\x64",
        b"\xc7\x01\x01a",
    ),
    *(b"\xdd\xff\xff\xff\xff", b"\xc0", b"\xa0", b"\xd9\x00"),
)
_NPY_WORDS = (
    *(
        b"\x93NUMPY",
        b"'descr': ",
        b"'fortran_order': True",
        b"'shape': (",
        b"(4, 3)",
        b"(-1, 3)",
        b"(True, 3)",
    ),
    *(
        b"'<f8'",
        b"'|O'",
        b"'>i8'",
        b"'<f2'",
        b"'<f16'",
        b"'<u8'",
        b"'|b1'",
        b"'<M8'",
        b"[('x', '<f4')]",
        b"L, ",
    ),
)
_ZIP_WORDS = (
    b"PK\x01\x02",
    b"PK\x03\x04",
    b"PK\x05\x06",
    b"PK\x06\x06",
    b"PK\x06\x07",
    b"points.npy",
    b"../",
)
_PCD_WORDS = (
    *(
        b"FIELDS x y z intensity\n",
        b"SIZE 4 4 4 4\n",
        b"TYPE F F F F\n",
        b"COUNT 1 1 1 1\n",
        b"COUNT 1000 1\n",
    ),
    *(
        b"WIDTH 12\n",
        b"HEIGHT 0\n",
        b"POINTS 0\n",
        b"DATA ascii\n",
        b"DATA binary\n",
        b"DATA binary_compressed\n",
    ),
    *(b" x", b" F", b" I", b" U", b" 8", b"\r\n", b"\n\n", b"#"),
)
_PLY_WORDS = (
    *(
        b"element vertex 12\n",
        b"element vertex 0\n",
        b"element face 1\n",
        b"property float x\n",
        b"end_header\n",
    ),
    *(b"property list uchar int a\n", b"property double z\n", b"property char intensity\n", b"comment \n"),
    *(b"format ascii 1.0\n", b"format binary_big_endian 1.0\n", b"\r\n", b"ply\n"),
)
_CALIBRATION_WORDS = (
    *(
        b"P2: ",
        b"P_rect_02: ",
        b"R0_rect: ",
        b"R_rect ",
        b"Tr_velo_to_cam: ",
        b"Tr_velo_cam ",
        b":",
        b"\n",
        b" ",
    ),
    *(
        b'"P2": ',
        b'"cam_T_velo": ',
        b'"R0_rect": ',
        b'"Tr_velo_to_cam": ',
        b'"image_size": ',
        b"[",
        b"]",
        b"{",
    ),
    *(
        b", ",
        b"[0, 0, 0, 1]",
        b"\xef\xbb\xbf",
        b"\x1b[31m",
        b'"\\u001b[31m": 1, ',
        b'"\\ud800": 1, ',
        b"\x85",
    ),
)
_PROMPT_WORDS = (
    *(b'"class": ', b'"box": ', b'"score": ', b'"Car"', b'{"class": "Car", "box": [1, 2, 3, 4]}', b"[", b"]"),
    *(
        b"{",
        b"}",
        b", ",
        b'"\\ud800"',
        b'"\\u0000"',
        b"[]",
        b'"a": 1, ',
        b'"a": 1, "a": 1, ',
        b"\xef\xbb\xbf",
    ),
)
_OPTION_WORDS = (
    *(
        b'"sizes": {',
        b'"repairs": {',
        b'"ground": {',
        b'"points": {',
        b'"preset": "paper"',
        b'"loss": {',
        b"}",
    ),
    *(
        b'"height_m": ',
        b'"templates": [',
        b'"spread": [',
        b'"source": "a"',
        b'"\\ud800"',
        b", ",
        b"{}",
        b"[]",
    ),
)
_TOML_WORDS = (
    *(
        b"[Car]\n",
        b"[[Car.templates]]\n",
        b"height_m = ",
        b"a.b.c = 1\n",
        b"source = ",
        b"'''",
        b'"""',
        b"\\u0000",
    ),
    *(b'"\\u001b"', b"2020-01-01", b"{a = 1}", b"[1, 2]", b"0xff", b"\r", b"[a.'\x1b']\n", b"spread = "),
)
_PNG_WORDS = (
    *(
        b"IHDR",
        b"PLTE",
        b"IDAT",
        b"IEND",
        b"tRNS",
        b"acTL",
        b"fcTL",
        b"fdAT",
        b"eXIf",
        b"pHYs",
        b"gAMA",
        b"cHRM",
    ),
    *(b"transparency\x00", b"bbox\x00", b"interlace\x00", b"exif\x00", b"dpi\x00", b"duration\x00", b"sRGB"),
)
_JPEG_WORDS = (
    *(b"\xff\xd8", b"\xff\xd9", b"\xff\xda", b"\xff\xc0", b"\xff\xc2", b"\xff\xc4", b"\xff\xdb", b"\xff\xdd"),
    *(b"\xff\xe1", b"\xff\xe2", b"\xff\xee", b"\xff\xff", b"\xff\x00", b"Exif\x00\x00II*\x00", b"MPF\x00"),
    *(b"Adobe\x00", b"ICC_PROFILE\x00\x01\x01", b"Photoshop 3.0\x008BIM\x03\xed"),
)


@cache
def decoders() -> dict[str, Decoder]:
    """The decoders by name."""
    return {
        "bin": Decoder(_points, seeds.kitti_bin()),
        "npy": Decoder(_points, seeds.npy(), _NPY_WORDS),
        "npz": Decoder(_points, seeds.npz(), _ZIP_WORDS + _NPY_WORDS, in_npz),
        "pcd-ascii": Decoder(_points, seeds.pcd("ascii"), _PCD_WORDS),
        "pcd-binary": Decoder(_points, seeds.pcd("binary"), _PCD_WORDS),
        "pcd-compressed": Decoder(_points, seeds.pcd("binary_compressed"), _PCD_WORDS, in_lzf),
        "ply-ascii": Decoder(_points, seeds.ply("ascii"), _PLY_WORDS),
        "ply-little": Decoder(_points, seeds.ply("binary_little_endian"), _PLY_WORDS),
        "ply-big": Decoder(_points, seeds.ply("binary_big_endian"), _PLY_WORDS),
        "calib-text": Decoder(_calibration, seeds.calibration_text(), _CALIBRATION_WORDS),
        "calib-json": Decoder(_calibration, seeds.calibration_json(), _CALIBRATION_WORDS),
        "calib-camera": Decoder(
            _camera, seeds.calibration_text() + seeds.calibration_json(), _CALIBRATION_WORDS
        ),
        "camera-config": Decoder(_camera_config, seeds.camera_config(), _CALIBRATION_WORDS),
        "prompts": Decoder(_prompts, seeds.prompts(), _PROMPT_WORDS),
        "prompt-lists": Decoder(_prompt_lists, seeds.prompt_lists(), _PROMPT_WORDS),
        "options": Decoder(_options, seeds.options(), _OPTION_WORDS),
        "priors": Decoder(_size_priors, seeds.size_priors(), _TOML_WORDS),
        "png": Decoder(_image, seeds.png(), _PNG_WORDS, in_png),
        "jpeg": Decoder(_image, seeds.jpeg(), _JPEG_WORDS, in_jpeg),
        "png-header": Decoder(_image_size, seeds.png(), _PNG_WORDS, in_png),
        "jpeg-header": Decoder(_image_size, seeds.jpeg(), _JPEG_WORDS, in_jpeg),
        "masks": Decoder(_masks, seeds.masks(), _PNG_WORDS, in_png),
        "form": Decoder(bodies.read_form_body, bodies.form_bodies(), _FORM_WORDS),
        "form-type": Decoder(bodies.read_form_type, bodies.form_types(), _FORM_WORDS),
        "msgpack": Decoder(bodies.read_msgpack_body, bodies.msgpack_bodies(), _MSGPACK_WORDS),
    }
