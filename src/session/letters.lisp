;;; anmech: what the names of variables are made of: Greek letters, indices.
;;;
;;; Entry points: GREEK-PLACE, STEM-AND-INDEX.

(in-package :anmech)

(defparameter *greek*
  '("alpha" "beta" "gamma" "delta" "epsilon" "zeta" "eta" "theta" "iota" "kappa" "lambda" "mu" "nu" "xi" "omicron" "pi"
    "rho" "" "sigma" "tau" "upsilon" "phi" "chi" "psi" "omega")
  "In the order of Unicode, where the second small sigma stands after the first.")

(defun greek-place (name)
  "The place in the alphabet of the letter that NAME is the name of, or nil; and whether it is a capital one."
  (let* ((bare (string-left-trim "%" name))
         (place (and (plusp (length bare)) (position bare *greek* :test #'string-equal))))
    (values place (and place (upper-case-p (char bare 0))))))

(defun stem-and-index (name)
  "Of x_1 and x1, x and 1; of other names, themselves and nil."
  (let* ((bar (position #\_ name :start (min 1 (length name))))
         (digits (1+ (or (position-if-not #'digit-char-p name :from-end t) (1- (length name))))))
    (cond ((and bar (< (1+ bar) (length name))) (values (subseq name 0 bar) (subseq name (1+ bar))))
          ((< digits (length name)) (values (subseq name 0 digits) (subseq name digits)))
          (t (values name nil)))))
