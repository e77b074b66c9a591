# SPDX-License-Identifier: Apache-2.0
"""One thread for torch: at these sizes more of them only wait for each other."""

from __future__ import annotations

import torch

torch.set_num_threads(1)
