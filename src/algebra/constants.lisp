;;; anmech: constants that are algebraic numbers in disguise.
;;;
;;; exp(%i*%pi*r) is a root of unity for rational r, so cos(%pi/8) and (-1)^(1/5) are sums of such; %phi is
;;; (1 + sqrt(5))/2.
;;;
;;; Entry points: NEEDED-UNIT-ORDER, TURNS, CONSTANT-FORM-P, ALGEBRAIC-FORM-P, WITH-PLAIN-CONSTANTS, AS-NUMBER,
;;; SPLIT-NUMBER, TERMS-OF.

(in-package :anmech)
(needs "session/scope" "algebra/terms")

(defun as-number (form)
  "The rational number that FORM is, or nil."
  (cond ((rationalp form) form)
        ((operator-p form 'maxima::rat) (/ (second form) (third form)))))

(defun terms-of (form)
  (if (operator-p form 'maxima::mplus) (rest form) (list form)))

(defun split-number (term)
  "The rational factor of TERM, and the rest."
  (let ((number (if (operator-p term 'maxima::mtimes) (as-number (second term)) (as-number term))))
    (cond ((null number) (values 1 term))
          ((as-number term) (values number 1))
          (t (values number (apply #'product-of (cddr term)))))))

(defun turns (number rest)
  "r if NUMBER * REST is %i*%pi*r; else nil."
  (and (operator-p rest 'maxima::mtimes)
       (= 3 (length rest))
       (member 'maxima::$%i (rest rest))
       (member 'maxima::$%pi (rest rest))
       number))

(defparameter *named-constants* '(maxima::$%pi maxima::$%e maxima::$%i maxima::$%gamma maxima::$%catalan))

(defun constant-form-p (form)
  (subsetp (symbols-in form) *named-constants*))

(defun algebraic-form-p (form)
  "Whether FORM is made of rational numbers, %i and roots."
  (and (subsetp (symbols-in form) '(maxima::$%i))
       (not (some-part (lambda (part)
                         (not (member (caar part) '(maxima::mplus maxima::mtimes maxima::mexpt maxima::rat))))
                       form))))

(defun with-plain-constants (symbol)
  "SYMBOL, or what it stands for."
  (if (eq symbol 'maxima::$%phi)
      (maxima::div (maxima::add 1 (power-of 5 '((maxima::rat maxima::simp) 1 2))) 2)
      symbol))

;;; Roots of unity that occur

(defparameter *circular* '(maxima::%sin maxima::%cos maxima::%tan maxima::%cot maxima::%sec maxima::%csc))

(defparameter *largest-unit-order* 5000)

(defun denominators-of-turns (exponent)
  "The denominators of the numbers before %i*%pi in the terms of EXPONENT."
  (loop for term in (terms-of (maxima::$expand exponent))
        for turns = (multiple-value-call #'turns (split-number term))
        when turns collect (denominator turns)))

(defun needed-unit-order (forms)
  "A multiple of 24, and of the orders of the roots of unity in FORMS."
  (let ((order 24))
    (labels ((note (denominators)
               (dolist (denominator denominators)
                 (let ((larger (lcm order (* 2 denominator))))
                   (when (<= larger *largest-unit-order*) (setq order larger)))))
             (look (part)
               (cond ((member (caar part) *circular*)
                      (note (denominators-of-turns (maxima::mul 'maxima::$%i (second part)))))
                     ((not (eq (caar part) 'maxima::mexpt)))
                     ((eq (second part) 'maxima::$%e) (note (denominators-of-turns (third part))))
                     ((and (root-p part) (as-number (second part)) (minusp (as-number (second part))))
                      (note (list (denominator (as-number (third part)))))))
               nil))
      (dolist (form forms order)
        (when (some-part (lambda (part) (or (member 'maxima::$%pi (rest part)) (root-p part))) form)
          (some-part #'look form))))))
