"""The forms of network there are, by name, and networks made in them."""

from typing import Any

import torch

from ..errors import InputError
from .fading import FadingForm
from .gated import GatedForm
from .paper import PaperForm
from .protocol import Form, FormSettings, HearingNetworks
from .pursuit import PursuitForm
from .windows import WindowsForm

FORMS: dict[str, Form[Any, Any]] = {
    form.name: form for form in (PaperForm(), GatedForm(), FadingForm(), WindowsForm(), PursuitForm())
}


def new_networks(settings: FormSettings, generator: torch.Generator | None = None) -> HearingNetworks:
    """Networks in the form that these settings train: drawn anew, or to be filled where there is no ``generator``."""
    networks: HearingNetworks = FORMS[settings.form].new(settings, generator)
    return networks


def continued_networks(settings: FormSettings, start: HearingNetworks) -> HearingNetworks:
    """Networks in the form that these settings train, which decide as ``start`` does.

    Raises:
        InputError: another form of network, or one network is to stand for x, y and z, and those of ``start`` are not
            the same.
    """
    if settings.form != start.form:
        raise InputError(f"these initial weights are of the form {start.form}, and {settings.form} is to be trained")
    networks: HearingNetworks = FORMS[start.form].continued(settings, start)
    return networks


def deployed(networks: HearingNetworks) -> HearingNetworks:
    """Networks as weights files hold them, which decide as the trained ones do, scales within their weights."""
    filed: HearingNetworks = FORMS[networks.form].deployed(networks)
    return filed
