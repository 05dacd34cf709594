;;; Real numbers of Maxima, and the doubles next to them.
;;;
;;; Entry points: exact-value, with-digits, neighbour, double-p, doubles, equal-parts, two-digits, short-text,
;;; short-text-of-error; $anmech_double, $anmech_with_digits, $anmech_is_number, $anmech_are_numbers,
;;; $anmech_numbers_of, $anmech_those_within.

(in-package :anmech)
(needs "session/scope" "session/texts" "numerics/dag")

(defun with-digits (digits form)
  "The value of FORM where bigfloats have so many digits."
  (maxima::meval `((maxima::mprog) ((maxima::mlist) ((maxima::msetq) maxima::$fpprec ,digits)) ,form)))

(maxima::defmspec maxima::$anmech_with_digits (form)
  "anmech_with_digits(n, expr): the value of expr, computed where bigfloats have n digits."
  (with-digits (maxima::meval (second form)) (third form)))

(defun exact-value (form &optional (digits 40))
  "The rational value of a real number of Maxima, of an irrational one to DIGITS; nil if FORM is no finite number."
  (flet ((rational-of (form)
           (cond ((rationalp form) form)
                 ((floatp form) (to-rational form form))
                 ((operator-p form 'maxima::rat) (/ (second form) (third form)))
                 ((operator-p form 'maxima::bigfloat) (bigfloat-value form)))))
    (handler-case (or (rational-of form)
                      (rational-of (with-digits digits `((maxima::$bfloat) ((maxima::mquote) ,form)))))
      (unsupported-expression () nil))))

(defun neighbour (number exact)
  "The double next to NUMBER on the side of EXACT; NUMBER itself where it is exact."
  (multiple-value-bind (mantissa exponent sign) (integer-decode-float number)
    (let ((difference (- exact (* sign mantissa (expt 2 exponent)))))
      (if (or (zerop difference) (zerop number))
          number
          (to-double (* (+ (* sign mantissa) (signum difference)) (expt 2 exponent)))))))

(defun double-p (exact)
  "Whether the rational EXACT, which is neither huge nor tiny, is a double."
  (let ((denominator (denominator exact)))
    (and (< (integer-length (numerator exact)) 54) (zerop (logand denominator (1- denominator))))))

(defun doubles (numbers)
  (let ((array (make-array (length numbers) :element-type 'double-float)) (place -1))
    (dolist (number numbers array)
      (setf (aref array (incf place)) number))))

(defun decimal-unit (number)
  "A power of ten: the second significant decimal of the positive NUMBER is a multiple of it."
  (let ((exact (rational number)) (power (expt 10 (floor (log number 10)))))        ; but for roundings of the logarithm
    (/ (cond ((< exact power) (/ power 10)) ((>= exact (* 10 power)) (* 10 power)) (t power)) 10)))

(defun two-digits (number)
  "NUMBER rounded up to two significant decimals, or a neighbour of that which Maxima shows with fewer digits."
  (if (zerop number)
      number
      (multiple-value-bind (digits power) (digits-above number)
        (if digits
            (shortest-of-digits digits power)
            (let ((unit (decimal-unit number)))
              (shortest-near (* unit (ceiling (exact-value number) unit))))))))

(defun digits-above (number)
  "Two digits as an integer, and a power of ten: times it they are NUMBER rounded up.  Nil where doubles do not tell."
  (when (< 1d-250 number 1d250)
    (let* ((power (1- (floor (log number 10d0)))) (quotient (/ number (expt 10d0 power))) (digits (ceiling quotient)))
      (and (<= 10.001d0 quotient 98.999d0) (< 1d-6 (- digits quotient) 0.999999d0) (values digits power)))))

(defvar *shortest* (make-hash-table :test #'eql) "What SHORTEST-NEAR has found: to make texts takes long.")
(defvar *shortest-of-digits* (make-hash-table :test #'eql) "The same, from digits and power of ten in one integer.")

(defun shortest-of-digits (digits power)
  (let ((key (+ digits (* 100 power))))
    (or (gethash key *shortest-of-digits*)
        (setf (gethash key *shortest-of-digits*) (shortest-near (* digits (expt 10 power)))))))

(defun shortest-near (number)
  "A double next to the rational NUMBER, of two decimals, which Maxima shows with few digits."
  (or (gethash number *shortest*)
      (let ((nearest (to-double number)))
        (setf (gethash number *shortest*)
              (first (sort (list nearest (neighbour nearest (* 2 number)) (neighbour nearest 0))
                           #'< :key (lambda (number) (length (maxima-text number)))))))))

(defun short-text (number)
  "NUMBER with two digits, for a message: 1.0, 25, 0.0041, 12000; below 1e-3 and from 1e5 on with a power of ten."
  (cond ((zerop number) "0")
        ((minusp number) (concatenate 'string "-" (positive-short-text (- number))))
        (t (positive-short-text number))))

(defun positive-short-text (number)
  (let* ((digits (decimal-unit number))
         (rounded (* digits (round (exact-value number) digits)))
         (unit (decimal-unit rounded))                            ; 9.96 has become 10
         (power (round (log unit 10)))
         (two (round rounded unit)))
    (cond ((<= 0 power 3) (format nil "~d" rounded))
          ((<= -4 power -1) (decimal-digits-text two (- power)))
          (t (format nil "~ae~d" (decimal-digits-text two 1) (1+ power))))))

(defun decimal-digits-text (digits places)
  "The integer DIGITS divided by 10^PLACES, PLACES digits behind the point."
  (multiple-value-bind (whole rest) (floor digits (expt 10 places))
    (format nil "~d.~v,'0d" whole places rest)))

(defun short-text-of-error (number)
  "NUMBER, which an error does not exceed, with two digits that it does not exceed either, as estimates have them."
  (short-text (two-digits number)))

(maxima::defmfun maxima::$anmech_double (form)
  "anmech_double(number): the double next to it; false if it is no finite real number."
  (if (and (floatp form) (or (eql form 0d0) (< 0 (abs form) most-positive-double-float)))     ; most are already
      form
      (let ((value (exact-value form)))
        (and value (handler-case (to-double value) (unsupported-expression () nil))))))

(maxima::defmfun maxima::$anmech_is_number (form)
  "anmech_is_number(form): whether it is a finite real number that a double can hold."
  (and (maxima::$anmech_double form) t))

(maxima::defmfun maxima::$anmech_are_numbers (list)
  "anmech_are_numbers(list): whether each element is a finite real number."
  (every #'maxima::$anmech_double (rest list)))

(maxima::defmfun maxima::$anmech_numbers_of (names equations)
  "anmech_numbers_of([name, ...], [name = number, ...]): the numbers in the order of the names; false unless there is
one for each, and nothing else."
  (let ((names (rest names)) (given (and (operator-p equations 'maxima::mlist) (rest equations))))
    (and (operator-p equations 'maxima::mlist)
         (= (length names) (length given))
         (every (lambda (equation)
                  (and (operator-p equation 'maxima::mequal) (maxima::$anmech_double (third equation))))
                given)
         (let ((found (mapcar (lambda (name) (find name given :key #'second :test #'maxima::alike1)) names)))
           (and (notany #'null found)
                (cons '(maxima::mlist maxima::simp) (mapcar #'third found)))))))

(maxima::defmfun maxima::$anmech_those_within (list start end within)
  "anmech_those_within([number, ...], start, end, within): as doubles those between START and END; if within is false,
those outside, as they are; if it is :given, those between, as they are."
  (let ((low (min start end)) (high (max start end)))
    (cons '(maxima::mlist maxima::simp)
          (loop for given in (rest list)
                for number = (if (floatp given) given (maxima::$anmech_double given))
                when (eq (and within t) (<= low number high)) collect (if (eq within t) number given)))))

(defun equal-parts (start end count)
  "So many numbers from START to END, equally far from each other; one if these are equal."
  (if (= start end)
      (list start)
      (loop for k from 0 below count
            collect (if (= k (1- count)) end (+ start (/ (* (- end start) k) (- count 1)))))))
